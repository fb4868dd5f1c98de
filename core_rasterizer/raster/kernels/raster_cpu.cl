/* Rasterization on a CPU: one work-item per tile, with pixel state in private arrays. Each Gaussian is
 * blended into the rows of its box in vectors, one column of vectors at a time. If most of the box is outside
 * the ellipse, columns visit only rows that it reaches; otherwise the square root costs more than it saves.
 *
 * A vector holds COLUMNS pixels of each of ROWS rows, whose pixels alternate in memory: it may start at any
 * column, and fits a small Gaussian better than one long row. */
#define COLUMNS 8
#define ROWS (LANES / COLUMNS)
#define STRIDE (ROWS * (TILE_WIDTH + COLUMNS)) /* vectors may end beyond the tile */
#define PIXELS ((TILE_HEIGHT + ROWS - 1) / ROWS * STRIDE)
#define AT(x, y) ((y) / ROWS * STRIDE + (x) * ROWS + (y) % ROWS)
/* b^2 / (a c) above which an ellipse is slanted: 4 is a line, and 3 fills 39 % of its box. */
#ifndef SLANTED
#define SLANTED 3
#endif
#define PAIRS_AHEAD 12 /* Gaussians to prefetch ahead; their data is scattered in memory */
#define CHECK_EVERY 32 /* Gaussians between two tests whether the whole tile is finished */

typedef struct {
    int x, y, width, height; /* pixels of the image that the tile covers */
} tile_area;

static inline tile_area area_of(uint tile, int tiles_x, __global const wide *camera)
{
    tile_area area;
    area.x = (int)(tile % tiles_x) * TILE_WIDTH;
    area.y = (int)(tile / tiles_x) * TILE_HEIGHT;
    area.width = min(TILE_WIDTH, (int)camera[CAMERA_WIDTH] - area.x);
    area.height = min(TILE_HEIGHT, (int)camera[CAMERA_HEIGHT] - area.y);
    return area;
}

/* A Gaussian's box within the tile, in tile coordinates; rows begin and end where vectors do. */
typedef struct {
    int x0, x1, y0, y1;
} pixel_box;

static inline pixel_box box_in(__global const real *record, tile_area area)
{
    pixel_box box;
    box.x0 = max((int)record[REC_X0] - area.x, 0);
    box.x1 = min((int)record[REC_X1] - area.x, area.width);
    box.y0 = max((int)record[REC_Y0] - area.y, 0) / ROWS * ROWS;
    box.y1 = (min((int)record[REC_Y1] - area.y, area.height) + ROWS - 1) / ROWS * ROWS;
    return box;
}

static inline int is_slanted(__global const real *g, pixel_box box)
{
    return box.x1 - box.x0 > COLUMNS && box.y1 - box.y0 > COLUMNS
        && g[REC_B] * g[REC_B] > (real)SLANTED * g[REC_A] * g[REC_C];
}

/* The part of a column of vectors that is visited: offsets in the tile, and the first vector's dy. */
typedef struct {
    int begin, end;
    lane dy;
} column_part;

/* Leaves out rows where a slanted ellipse of alpha >= 1/255 does not reach the COLUMNS columns from `x` on. The
 * exponent is c (dy - slope dx)^2 + e dx^2 with slope = -b / (2 c) and e = a - b^2 / (4 c). */
static inline void skip_rows_outside(
    column_part *part, __global const real *g, pixel_box box, tile_area area, int x,
    real floor_of_alpha)
{
    const real a = g[REC_A], b = g[REC_B], c = g[REC_C];
    const real left = area.x + x + (real)0.5 - g[REC_X], right = left + (COLUMNS - 1);
    const real nearest = left > 0 ? left : (right < 0 ? right : 0);
    const real farthest = -left > right ? left : right;
    const real slope = (real)-0.5 * b / c, e = a + (real)0.5 * b * slope;
    /* The margin exceeds the rounding errors of the exponent, because the test of each pixel decides. */
    const real level = floor_of_alpha + (real)4e-6 * a * farthest * farthest - (real)1e-3;
    const real square = (level - (e < 0 ? e : 0) * nearest * nearest) / c;
    if (square < 0) {
        part->end = part->begin;
        return;
    }
    const real reach = sqrt(square) + (real)1e-2, origin = g[REC_Y] - area.y - (real)0.5;
    const real low = origin + fmin(slope * left, slope * right) - reach;
    const real high = origin + fmax(slope * left, slope * right) + reach;
    /* An undefined value (c of a needle rounded to 0) keeps all rows. */
    const int y0 = (int)fmin(fmax(low, (real)box.y0), (real)box.y1) / ROWS * ROWS;
    const int y1 = ((int)fmax(fmin(high + 1, (real)box.y1), (real)y0) + ROWS - 1) / ROWS * ROWS;
    for (; part->begin < AT(x, y0); part->begin += STRIDE)
        part->dy += ROWS; /* one by one, for the same bits */
    part->end = AT(x, y1);
}

/* Pixels outside the image start finished, so that no other code tests for the image's edge. */
static inline void start_pixels(real *transmittance, tile_area area)
{
    for (int i = 0; i < PIXELS; i++)
        transmittance[i] = (real)-1;
    for (int y = 0; y < area.height; y++)
        for (int x = 0; x < area.width; x++)
            transmittance[AT(x, y)] = (real)1;
}

static inline int all_finished(const real *transmittance)
{
    lane largest = (lane)-1;
    for (int i = 0; i < PIXELS; i += LANES) {
        const lane here = LOAD(transmittance + i);
        largest = LANE_MAX(largest, here);
    }
    for (int l = 0; l < LANES; l++)
        if (LANE_AT(largest, l) > 0)
            return 0;
    return 1;
}

/* Offsets of a vector's pixels from its first one. */
#if ROWS == 1
#define ACROSS ((lane)(0, 1, 2, 3, 4, 5, 6, 7))
#define DOWN ((lane)0)
#else
#define ACROSS ((lane)(0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7))
#define DOWN ((lane)(0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1))
#endif

/* The pixels of a tile that no Gaussian reaches. */
static inline void show_background(
    tile_area area, __global const wide *camera, __global real *rgb, __global real *depth,
    __global real *alpha, __global real *final_transmittance)
{
    const int width = (int)camera[CAMERA_WIDTH];
    const real red = camera[CAMERA_BACKGROUND], green = camera[CAMERA_BACKGROUND + 1],
               blue = camera[CAMERA_BACKGROUND + 2];
    for (int y = area.y; y < area.y + area.height; y++) {
        const size_t first = (size_t)y * width + area.x;
        /* One loop per image, which compilers vectorize, unlike stores to four arrays. */
        for (size_t pixel = first; pixel < first + area.width; pixel++) {
            rgb[3 * pixel] = red;
            rgb[3 * pixel + 1] = green;
            rgb[3 * pixel + 2] = blue;
        }
        for (size_t pixel = first; pixel < first + area.width; pixel++)
            depth[pixel] = 0;
        for (size_t pixel = first; pixel < first + area.width; pixel++)
            alpha[pixel] = 0;
        for (size_t pixel = first; pixel < first + area.width; pixel++)
            final_transmittance[pixel] = 1;
    }
}

/* Adds a Gaussian to the pixels of its box. */
static inline __attribute__((always_inline)) void blend(
    __global const real *g, tile_area area, pixel_box box, real *t, real *red, real *green,
    real *blue, real *z, const int slanted)
{
    const real a = g[REC_A], b = g[REC_B], c = g[REC_C], opacity = g[REC_OPACITY];
    const real r = g[REC_RED], gr = g[REC_GREEN], bl = g[REC_BLUE], depth_here = g[REC_Z];
    const real floor_of_alpha = slanted ? -log2((real)ALPHA_CUT_INVERSE * opacity) : 0;
    const lane first_dy = (area.y + box.y0 + (real)0.5 - g[REC_Y]) - g[REC_REST_Y] + DOWN;
    for (int x = box.x0; x < box.x1; x += COLUMNS) {
        const lane dx = (area.x + x + (real)0.5 - g[REC_X]) - g[REC_REST_X] + ACROSS;
        const lane square = a * dx * dx, slope = b * dx;
        column_part part = {AT(x, box.y0), AT(x, box.y1), first_dy};
        if (slanted)
            skip_rows_outside(&part, g, box, area, x, floor_of_alpha);
        lane dy = part.dy;
        for (int i = part.begin; i < part.end; i += STRIDE, dy += ROWS) {
            const lane before = LOAD(t + i);
            const contribution m = contribution_at(square + dy * (slope + c * dy), opacity, before);
            STORE(t + i, keep_transmittance(m, before));
            STORE(red + i, LOAD(red + i) + m.weight * r);
            STORE(green + i, LOAD(green + i) + m.weight * gr);
            STORE(blue + i, LOAD(blue + i) + m.weight * bl);
            STORE(z + i, LOAD(z + i) + m.weight * depth_here);
        }
    }
}

__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void raster(
    __global const real *records, __global const uint2 *pairs, __global const uint *tile_starts,
    __global const ulong *counters, __global const wide *camera, __global real *rgb,
    __global real *depth, __global real *alpha, __global real *final_transmittance, int tiles_x,
    uint pair_capacity)
{
    if (counters[COUNT_PAIRS] > pair_capacity)
        return;
    const uint tile = get_global_id(0);
    const tile_area area = area_of(tile, tiles_x, camera);
    const uint begin = tile_starts[tile], end = tile_starts[tile + 1];
    if (begin == end) {
        show_background(area, camera, rgb, depth, alpha, final_transmittance);
        return;
    }
    real t[PIXELS], red[PIXELS], green[PIXELS], blue[PIXELS], z[PIXELS];
    start_pixels(t, area);
    for (int i = 0; i < PIXELS; i++)
        red[i] = green[i] = blue[i] = z[i] = 0;

    for (uint p = begin; p < end; p++) {
        if ((p - begin) % CHECK_EVERY == CHECK_EVERY - 1 && all_finished(t))
            break;
        __global const real *g = records + (size_t)pairs[p].x * REC_SIZE;
        if (p + PAIRS_AHEAD < end)
            PREFETCH(records + (size_t)pairs[p + PAIRS_AHEAD].x * REC_SIZE);
        const pixel_box box = box_in(g, area);
        if (is_slanted(g, box))
            blend(g, area, box, t, red, green, blue, z, 1);
        else
            blend(g, area, box, t, red, green, blue, z, 0);
    }

    const int width = (int)camera[CAMERA_WIDTH];
    __global const wide *background = camera + CAMERA_BACKGROUND;
    for (int y = 0; y < area.height; y++)
        for (int x = 0; x < area.width; x++) {
            const int i = AT(x, y);
            const size_t pixel = (size_t)(area.y + y) * width + area.x + x;
            const real left = t[i] < 0 ? -t[i] : t[i];
            rgb[3 * pixel] = red[i] + left * (real)background[0];
            rgb[3 * pixel + 1] = green[i] + left * (real)background[1];
            rgb[3 * pixel + 2] = blue[i] + left * (real)background[2];
            depth[pixel] = z[i];
            alpha[pixel] = 1 - left;
            final_transmittance[pixel] = left;
        }
}

typedef GLUE(REAL_NAME, 4) quad;
typedef quad quad_anywhere __attribute__((aligned(sizeof(real))));
typedef GLUE(REAL_NAME, 8) octet;

static inline octet octet_of(lane a)
{
#if LANES == 16
    return a.lo + a.hi;
#else
    return a;
#endif
}

/* The sums of four vectors; summed together, because four separate sums would leave most lanes idle. */
static inline quad sum_quad(lane first, lane second, lane third, lane fourth)
{
    const octet a = octet_of(first), b = octet_of(second), c = octet_of(third),
                d = octet_of(fourth);
    const octet ab = (octet)(a.s0, b.s0, a.s1, b.s1, a.s4, b.s4, a.s5, b.s5)
        + (octet)(a.s2, b.s2, a.s3, b.s3, a.s6, b.s6, a.s7, b.s7);
    const octet cd = (octet)(c.s0, d.s0, c.s1, d.s1, c.s4, d.s4, c.s5, d.s5)
        + (octet)(c.s2, d.s2, c.s3, d.s3, c.s6, d.s6, c.s7, d.s7);
    const octet abcd = (octet)(ab.s01, cd.s01, ab.s45, cd.s45)
        + (octet)(ab.s23, cd.s23, ab.s67, cd.s67);
    return abcd.lo + abcd.hi;
}

/* Loads the tile's output gradients, and `rest`: the contribution of the remaining Gaussians and the
 * background to the loss. */
static inline void load_gradients(
    tile_area area, int width, __global const real *rgb, __global const real *depth,
    __global const real *final_transmittance, __global const real *d_rgb,
    __global const real *d_depth, __global const real *d_alpha, real *red, real *green, real *blue,
    real *z, real *rest)
{
    for (int i = 0; i < PIXELS; i++)
        red[i] = green[i] = blue[i] = z[i] = rest[i] = 0;
    for (int y = 0; y < area.height; y++)
        for (int x = 0; x < area.width; x++) {
            const int i = AT(x, y);
            const size_t pixel = (size_t)(area.y + y) * width + area.x + x;
            red[i] = d_rgb[3 * pixel];
            green[i] = d_rgb[3 * pixel + 1];
            blue[i] = d_rgb[3 * pixel + 2];
            z[i] = d_depth[pixel];
            rest[i] = rgb[3 * pixel] * red[i] + rgb[3 * pixel + 1] * green[i]
                + rgb[3 * pixel + 2] * blue[i] + depth[pixel] * z[i]
                - final_transmittance[pixel] * d_alpha[pixel];
        }
}

/* Gradients of a (tile, Gaussian) pair, summed over its pixels, lane by lane. */
typedef struct {
    lane p, px, py, pxx, pxy, pyy; /* of the exponent, times powers of dx and dy */
    lane red, green, blue, z, touched;
#ifdef ABSOLUTE
    lane absolute_x, absolute_y;
#endif
} lane_sums;

/* Adds the gradients of the pixels of a Gaussian's box. With v = c . dL/dC + z dL/dD of the Gaussian and `rest`
 * the same sum over everything behind it: dL/dalpha = (T_next v - rest) / (1 - alpha). */
static inline __attribute__((always_inline)) void blend_backward(
    __global const real *g, tile_area area, pixel_box box, real *t, const real *red,
    const real *green, const real *blue, const real *z, real *rest, lane_sums *sums,
    const int with_depth, const int slanted)
{
    const real a = g[REC_A], b = g[REC_B], c = g[REC_C], opacity = g[REC_OPACITY];
    const real r = g[REC_RED], gr = g[REC_GREEN], bl = g[REC_BLUE], depth_here = g[REC_Z];
    const real floor_of_alpha = slanted ? -log2((real)ALPHA_CUT_INVERSE * opacity) : 0;
    const lane first_dy = (area.y + box.y0 + (real)0.5 - g[REC_Y]) - g[REC_REST_Y] + DOWN;
    for (int x = box.x0; x < box.x1; x += COLUMNS) {
        const lane dx = (area.x + x + (real)0.5 - g[REC_X]) - g[REC_REST_X] + ACROSS;
        const lane square = a * dx * dx, slope = b * dx;
        lane column_p = (lane)0, column_py = (lane)0, column_pyy = (lane)0;
        column_part part = {AT(x, box.y0), AT(x, box.y1), first_dy};
        if (slanted)
            skip_rows_outside(&part, g, box, area, x, floor_of_alpha);
        lane dy = part.dy;
        for (int i = part.begin; i < part.end; i += STRIDE, dy += ROWS) {
            const lane before = LOAD(t + i);
            const contribution m = contribution_at(square + dy * (slope + c * dy), opacity, before);
            STORE(t + i, keep_transmittance(m, before));
            const lane d_red = LOAD(red + i), d_green = LOAD(green + i), d_blue = LOAD(blue + i);
            lane value = r * d_red + gr * d_green + bl * d_blue;
            if (with_depth) {
                const lane d_z = LOAD(z + i);
                value += depth_here * d_z;
                sums->z += m.weight * d_z;
            }
            const lane behind = LOAD(rest + i) - m.weight * value;
            STORE(rest + i, behind);
            const lane slope_alpha = (m.next * value - behind) / (1 - m.alpha);
            /* The gradient is 0 above the clamp and where nothing was added. */
            const lane_mask moves = (m.weight > (lane)0) & (m.raw <= (lane)ALPHA_MAX);
            const lane d_p = moves ? slope_alpha * m.alpha : (lane)0;
            column_p += d_p;
            column_py += d_p * dy;
            column_pyy += d_p * (dy * dy);
#ifdef ABSOLUTE
            sums->absolute_x += lane_abs(d_p * (2 * a * dx + b * dy));
            sums->absolute_y += lane_abs(d_p * (slope + 2 * c * dy));
#endif
            sums->red += m.weight * d_red;
            sums->green += m.weight * d_green;
            sums->blue += m.weight * d_blue;
            sums->touched += m.weight;
        }
        sums->p += column_p;
        sums->px += column_p * dx;
        sums->pxx += column_p * dx * dx;
        sums->py += column_py;
        sums->pxy += column_py * dx;
        sums->pyy += column_pyy;
    }
}

/* Front to back like the forward pass. */
static inline __attribute__((always_inline)) void walk_back(
    __global const real *records, __global const uint2 *pairs, __global const uint *tile_starts,
    __global const wide *camera, __global const real *rgb, __global const real *depth,
    __global const real *final_transmittance, __global const real *d_rgb,
    __global const real *d_depth, __global const real *d_alpha, __global real *pair_sums,
    int tiles_x, const int with_depth)
{
    const uint tile = get_global_id(0);
    const uint begin = tile_starts[tile], end = tile_starts[tile + 1];
    if (begin == end)
        return;
    const tile_area area = area_of(tile, tiles_x, camera);
    real t[PIXELS], red[PIXELS], green[PIXELS], blue[PIXELS], z[PIXELS], rest[PIXELS];
    start_pixels(t, area);
    load_gradients(
        area, (int)camera[CAMERA_WIDTH], rgb, depth, final_transmittance, d_rgb, d_depth, d_alpha,
        red, green, blue, z, rest);

    uint p = begin;
    for (; p < end; p++) {
        if ((p - begin) % CHECK_EVERY == CHECK_EVERY - 1 && all_finished(t))
            break;
        __global const real *g = records + (size_t)pairs[p].x * REC_SIZE;
        if (p + PAIRS_AHEAD < end) {
            PREFETCH(records + (size_t)pairs[p + PAIRS_AHEAD].x * REC_SIZE);
            PREFETCH_TO_WRITE(pair_sums + (size_t)pairs[p + PAIRS_AHEAD].y * PAIR_SIZE);
        }
        const pixel_box box = box_in(g, area);
        lane_sums sums = {(lane)0};
        if (is_slanted(g, box))
            blend_backward(g, area, box, t, red, green, blue, z, rest, &sums, with_depth, 1);
        else
            blend_backward(g, area, box, t, red, green, blue, z, rest, &sums, with_depth, 0);
        __global quad_anywhere *out = (__global quad_anywhere *)(pair_sums
                                                                 + (size_t)pairs[p].y * PAIR_SIZE);
        out[0] = sum_quad(sums.p, sums.px, sums.py, sums.pxx);
        out[1] = sum_quad(sums.pxy, sums.pyy, sums.red, sums.green);
#ifdef ABSOLUTE
        out[2] = sum_quad(sums.blue, sums.z, sums.touched, sums.absolute_x);
        out[3] = sum_quad(sums.absolute_y, (lane)0, (lane)0, (lane)0);
#else
        out[2] = sum_quad(sums.blue, sums.z, sums.touched, (lane)0);
#endif
    }
    for (; p < end; p++)
        for (int k = 0; k <= PAIR_LAST; k++)
            pair_sums[(size_t)pairs[p].y * PAIR_SIZE + k] = 0;
}

__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void raster_backward(
    __global const real *records, __global const uint2 *pairs, __global const uint *tile_starts,
    __global const wide *camera, __global const real *rgb, __global const real *depth,
    __global const real *final_transmittance, __global const real *d_rgb,
    __global const real *d_depth, __global const real *d_alpha, __global real *pair_sums,
    int tiles_x, int with_depth)
{
    /* Without a gradient of depth, this saves a load and two multiplications per pixel. */
    if (with_depth)
        walk_back(
            records, pairs, tile_starts, camera, rgb, depth, final_transmittance, d_rgb, d_depth,
            d_alpha, pair_sums, tiles_x, 1);
    else
        walk_back(
            records, pairs, tile_starts, camera, rgb, depth, final_transmittance, d_rgb, d_depth,
            d_alpha, pair_sums, tiles_x, 0);
}
