/* Rasterization on a GPU: one work-group per tile, one work-item per pixel; records are staged in local
 * memory. The pair buffer is the same as on a CPU. */

#define GROUP (TILE_WIDTH * TILE_HEIGHT)

#define BOX(quads) ((quads)[REC_X0 / 4])
#define LOAD_RECORD(g, quads)                                                                      \
    real g[REC_SIZE];                                                                              \
    for (int q = 0; q < QUADS; q++)                                                                \
    vstore4((quads)[q], q, g)

/* Copies the records of pairs [p, p + BUCKET) into local memory. */
static inline void stage(
    __local quad *staged, __global const quad *records, __global const uint2 *pairs, uint p,
    uint end)
{
    for (uint k = get_local_id(0); k < BUCKET * QUADS; k += GROUP)
        if (p + k / QUADS < end)
            staged[k] = records[(size_t)pairs[p + k / QUADS].x * QUADS + k % QUADS];
}

static inline real exponent_at(const real *g, real dx, real dy)
{
    return g[REC_A] * dx * dx + dy * (g[REC_B] * dx + g[REC_C] * dy);
}

/* Distances from the mean to a pixel's centre; the bracket is exact, the rest is the rounding error. */
static inline real distance_x(const real *g, int x)
{
    return (x + (real)0.5 - g[REC_X]) - g[REC_REST_X];
}

static inline real distance_y(const real *g, int y)
{
    return (y + (real)0.5 - g[REC_Y]) - g[REC_REST_Y];
}

/* Whether (int)x0 <= x < (int)x1 and the same for y. Integer coordinates need no conversion of the record's
 * floats, which GPUs do at a quarter of the rate of comparisons. */
static inline int in_box(quad box, int x, int y)
{
    const real right = x + 1, bottom = y + 1;
    return right > box.s0 && right <= box.s1 && bottom > box.s2 && bottom <= box.s3;
}

/* True in every work-item if `flagged` is true in any. */
static inline int any_in_group(__local int *flag, int flagged)
{
    barrier(CLK_LOCAL_MEM_FENCE);
    if (get_local_id(0) == 0)
        *flag = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (flagged)
        *flag = 1;
    barrier(CLK_LOCAL_MEM_FENCE);
    return *flag;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void raster(
    __global const quad *records, __global const uint2 *pairs, __global const uint *tile_starts,
    __global const ulong *counters, __global const wide *camera, __global real *rgb,
    __global real *depth, __global real *alpha, __global real *final_transmittance, int tiles_x,
    uint pair_capacity)
{
    __local quad staged[BUCKET * QUADS];
    __local int flag;
    if (counters[COUNT_PAIRS] > pair_capacity)
        return;
    const uint tile = get_group_id(0), local_id = get_local_id(0);
    const int x = (int)(tile % tiles_x) * TILE_WIDTH + (int)(local_id % TILE_WIDTH);
    const int y = (int)(tile / tiles_x) * TILE_HEIGHT + (int)(local_id / TILE_WIDTH);
    const int width = (int)camera[CAMERA_WIDTH], height = (int)camera[CAMERA_HEIGHT];
    const int in_image = x < width && y < height;
    real t = in_image ? 1 : -1, red = 0, green = 0, blue = 0, z = 0;

    const uint end = tile_starts[tile + 1];
    for (uint p = tile_starts[tile]; p < end; p += BUCKET) {
        if (!any_in_group(&flag, t > 0))
            break;
        stage(staged, records, pairs, p, end);
        barrier(CLK_LOCAL_MEM_FENCE);
        const uint batch = min((uint)BUCKET, end - p);
        for (uint k = 0; k < batch; k++) {
            __local const quad *quads = staged + k * QUADS;
            if (t < 0 || !in_box(BOX(quads), x, y))
                continue;
            LOAD_RECORD(g, quads);
            const real exponent = exponent_at(g, distance_x(g, x), distance_y(g, y));
            const contribution m = contribution_at(exponent, g[REC_OPACITY], t);
            t = keep_transmittance(m, t);
            red += m.weight * g[REC_RED];
            green += m.weight * g[REC_GREEN];
            blue += m.weight * g[REC_BLUE];
            z += m.weight * g[REC_Z];
        }
    }
    if (!in_image)
        return;
    const size_t pixel = (size_t)y * width + x;
    const real left = t < 0 ? -t : t;
    rgb[3 * pixel] = red + left * (real)camera[CAMERA_BACKGROUND];
    rgb[3 * pixel + 1] = green + left * (real)camera[CAMERA_BACKGROUND + 1];
    rgb[3 * pixel + 2] = blue + left * (real)camera[CAMERA_BACKGROUND + 2];
    depth[pixel] = z;
    alpha[pixel] = 1 - left;
    final_transmittance[pixel] = left;
}

/* The backward pass has one work-item per pair, not per pixel, so no sum crosses work-items
 * (Taming 3DGS, Mallick et al. 2024, section 4.3). A bucket is BUCKET neighbouring pairs of a tile. First,
 * `save_pixel_states` walks each tile like `raster` and stores the state of every pixel before each bucket; then
 * the buckets are independent. Bucket k of a tile has the place tile_starts[tile] / BUCKET + tile + k, which no
 * other has, without a prefix sum. */

static inline uint place_of_buckets(__global const uint *tile_starts, uint tile)
{
    return tile_starts[tile] / BUCKET + tile;
}

/* Stores transmittance and `rest` (see raster_cpu.cl) of each pixel, or in `unfinished` that none is unfinished. */
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void save_pixel_states(
    __global const quad *records, __global const uint2 *pairs, __global const uint *tile_starts,
    __global const wide *camera, __global const real *rgb, __global const real *depth,
    __global const real *final_transmittance, __global const real *d_rgb,
    __global const real *d_depth, __global const real *d_alpha, __global real *pixel_states,
    __global uint *unfinished, int tiles_x, int with_depth)
{
    __local quad staged[BUCKET * QUADS];
    __local int flag;
    const uint tile = get_group_id(0), local_id = get_local_id(0);
    const int x = (int)(tile % tiles_x) * TILE_WIDTH + (int)(local_id % TILE_WIDTH);
    const int y = (int)(tile / tiles_x) * TILE_HEIGHT + (int)(local_id / TILE_WIDTH);
    const int width = (int)camera[CAMERA_WIDTH], height = (int)camera[CAMERA_HEIGHT];
    real t = -1, red = 0, green = 0, blue = 0, z = 0, rest = 0;
    if (x < width && y < height) {
        const size_t pixel = (size_t)y * width + x;
        t = 1;
        red = d_rgb[3 * pixel];
        green = d_rgb[3 * pixel + 1];
        blue = d_rgb[3 * pixel + 2];
        z = with_depth ? d_depth[pixel] : (real)0;
        rest = rgb[3 * pixel] * red + rgb[3 * pixel + 1] * green + rgb[3 * pixel + 2] * blue
            + depth[pixel] * z - final_transmittance[pixel] * d_alpha[pixel];
    }
    const uint end = tile_starts[tile + 1];
    size_t place = place_of_buckets(tile_starts, tile);
    int any = 1;
    for (uint p = tile_starts[tile]; p < end; p += BUCKET, place++) {
        any = any && any_in_group(&flag, t > 0);
        if (local_id == 0)
            unfinished[place] = any;
        if (!any) /* the same for the whole group */
            continue;
        pixel_states[place * 2 * GROUP + local_id] = t;
        pixel_states[(place * 2 + 1) * GROUP + local_id] = rest;
        if (p + BUCKET >= end)
            break;
        stage(staged, records, pairs, p, end);
        barrier(CLK_LOCAL_MEM_FENCE);
        for (uint k = 0; k < BUCKET; k++) {
            __local const quad *quads = staged + k * QUADS;
            if (t < 0 || !in_box(BOX(quads), x, y))
                continue;
            LOAD_RECORD(g, quads);
            const real exponent = exponent_at(g, distance_x(g, x), distance_y(g, y));
            const contribution m = contribution_at(exponent, g[REC_OPACITY], t);
            t = keep_transmittance(m, t);
            rest -= m.weight
                * (g[REC_RED] * red + g[REC_GREEN] * green + g[REC_BLUE] * blue + g[REC_Z] * z);
        }
    }
}

/* The pixels of a tile in local memory. */
typedef struct {
    real t[GROUP], rest[GROUP], red[GROUP], green[GROUP], blue[GROUP], z[GROUP];
} tile_pixels;

static inline void load_pixels(
    __local tile_pixels *pixels, uint tile, int tiles_x, __global const wide *camera,
    __global const real *d_rgb, __global const real *d_depth, __global const real *state,
    int with_depth)
{
    const int width = (int)camera[CAMERA_WIDTH], height = (int)camera[CAMERA_HEIGHT];
    for (int k = get_local_id(0); k < GROUP; k += BUCKET) {
        const int x = (int)(tile % tiles_x) * TILE_WIDTH + k % TILE_WIDTH;
        const int y = (int)(tile / tiles_x) * TILE_HEIGHT + k / TILE_WIDTH;
        const int inside = x < width && y < height;
        const size_t pixel = inside ? (size_t)y * width + x : 0;
        pixels->t[k] = state[k];
        pixels->rest[k] = state[GROUP + k];
        pixels->red[k] = d_rgb[3 * pixel];
        pixels->green[k] = d_rgb[3 * pixel + 1];
        pixels->blue[k] = d_rgb[3 * pixel + 2];
        pixels->z[k] = with_depth ? d_depth[pixel] : (real)0;
    }
}

/* Adds what a pixel contributes to the sums of a pair, and moves the pixel behind the Gaussian. */
static inline void add_pixel(
    real *sums, const real *g, __local tile_pixels *pixels, int k, int x, int y)
{
    const real t = pixels->t[k], dx = distance_x(g, x), dy = distance_y(g, y);
    const real red = pixels->red[k], green = pixels->green[k], blue = pixels->blue[k],
               z = pixels->z[k];
    const contribution m = contribution_at(exponent_at(g, dx, dy), g[REC_OPACITY], t);
    pixels->t[k] = keep_transmittance(m, t);
    const real value = g[REC_RED] * red + g[REC_GREEN] * green + g[REC_BLUE] * blue + g[REC_Z] * z;
    const real rest = pixels->rest[k] - m.weight * value;
    pixels->rest[k] = rest;
    if (m.weight > 0 && m.raw <= ALPHA_MAX) {
        const real d_p = (m.next * value - rest) / (1 - m.alpha) * m.alpha;
        sums[PAIR_P] += d_p;
        sums[PAIR_PX] += d_p * dx;
        sums[PAIR_PY] += d_p * dy;
        sums[PAIR_PXX] += d_p * dx * dx;
        sums[PAIR_PXY] += d_p * dx * dy;
        sums[PAIR_PYY] += d_p * dy * dy;
#ifdef ABSOLUTE
        sums[PAIR_ABSOLUTE_X] += fabs(d_p * (2 * g[REC_A] * dx + g[REC_B] * dy));
        sums[PAIR_ABSOLUTE_Y] += fabs(d_p * (g[REC_B] * dx + 2 * g[REC_C] * dy));
#endif
    }
    sums[PAIR_RED] += m.weight * red;
    sums[PAIR_GREEN] += m.weight * green;
    sums[PAIR_BLUE] += m.weight * blue;
    sums[PAIR_Z] += m.weight * z;
    sums[PAIR_TOUCHED] += m.weight;
}

/* One work-group per bucket. In each round a work-item takes one pixel, a round after the work-item of the
 * pair before, so that pixels take pairs in depth order and pairs sum over pixels in a fixed order. Each
 * work-item keeps its record in registers: in local memory all records begin in the same two banks. */
__kernel __attribute__((reqd_work_group_size(BUCKET, 1, 1))) void raster_backward(
    __global const quad *records, __global const uint2 *pairs, __global const uint *tile_starts,
    __global const wide *camera, __global const real *d_rgb, __global const real *d_depth,
    __global const real *pixel_states, __global const uint *unfinished, __global quad *pair_sums,
    uint tiles, int tiles_x, int with_depth)
{
    __local tile_pixels pixels;
    const size_t place = get_group_id(0);
    const int id = get_local_id(0);
    uint tile = 0;
    /* The last tile whose buckets do not begin later. */
    for (uint beyond = tiles; beyond - tile > 1;) {
        const uint middle = tile + (beyond - tile) / 2;
        if (place_of_buckets(tile_starts, middle) <= place)
            tile = middle;
        else
            beyond = middle;
    }
    const uint end = tile_starts[tile + 1];
    const size_t first = tile_starts[tile] + (place - place_of_buckets(tile_starts, tile)) * BUCKET;
    if (first >= end) /* an unused place */
        return;
    const int has_pair = first + id < end;
    real sums[PAIR_SIZE];
    for (int k = 0; k < PAIR_SIZE; k++)
        sums[k] = 0;
    if (unfinished[place]) { /* the same for the whole group */
        __global const quad *quads = records + (has_pair ? (size_t)pairs[first + id].x : 0) * QUADS;
        LOAD_RECORD(g, quads);
        const quad box = has_pair ? BOX(quads) : (quad)0;
        load_pixels(
            &pixels, tile, tiles_x, camera, d_rgb, d_depth, pixel_states + place * 2 * GROUP,
            with_depth);
        const int x0 = (int)(tile % tiles_x) * TILE_WIDTH, y0 = (int)(tile / tiles_x) * TILE_HEIGHT;
        for (int round = 0; round < GROUP + BUCKET - 1; round++) {
            barrier(CLK_LOCAL_MEM_FENCE);
            const int k = round - id, x = x0 + k % TILE_WIDTH, y = y0 + k / TILE_WIDTH;
            if (k >= 0 && k < GROUP && in_box(box, x, y) && pixels.t[k] >= 0)
                add_pixel(sums, g, &pixels, k, x, y);
        }
    }
    if (has_pair)
        for (int q = 0; q <= PAIR_LAST / 4; q++)
            pair_sums[(size_t)pairs[first + id].y * (PAIR_SIZE / 4) + q] = vload4(q, sums);
}
