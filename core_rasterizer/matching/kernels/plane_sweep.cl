/* The cost volume of a plane sweep. Twin: tests/core_rasterizer/plane_sweep_oracle.py.
 *
 * A lane is one of LANES neighbouring planes of one pixel, all of them parallel to the reference
 * image. A work-item sweeps PLANES_PER_ITEM planes, LANES at a time, over a TILE_WIDTH x TILE_HEIGHT
 * tile: it warps each source view row by row, keeps for each column the sums over the last WINDOW rows,
 * and slides along the row over the sums of WINDOW columns. A sample is fetched once, added to each sum
 * once and subtracted once.
 *
 * Grey values are whole numbers in [-LEVELS, LEVELS], with LEVELS so small that every sum over a window
 * is at most 2^24, exact in float. Sums therefore neither drift nor depend on their order, and all devices
 * agree.
 *
 * A pixel x of the reference image at inverse depth w appears in a source view at A x + w b
 * (homogeneous), with A = K_s R K_r^-1, b = K_s t. A source's numbers: A row by row, then b. Pairs and
 * windows come from sweep_images.cl.
 */

#define WINDOW (2 * RADIUS + 1)
#define COLUMNS (TILE_WIDTH + 2 * RADIUS)
/* SOURCE_NUMBERS and SOURCE_LAYOUT come from sweep_geometry.py. */
#define NO_PLANE 255 /* the cost of padding planes; their depth is NaN */
#define UNKNOWN 128.0f /* where no view sees the point: the cost of ZNCC = 0 */
#define NOT_SEEN 1000.0f /* above every cost */
#define ROUNDER 12582912.0f /* 1.5 * 2^23: adding and subtracting it rounds to a whole number */

#if LANES == 1
typedef uchar lane_bytes;
#define TO_BYTES(x) ((uchar)(x))
#else
typedef GLUE(uchar, LANES) lane_bytes;
#define TO_BYTES(x) __builtin_convertvector((x), lane_bytes)
#endif

typedef struct {
    lane x, y, z; /* homogeneous pixel position */
} ray_points;

/* Where the reference pixel (x, y) lies in a source view; `shift` is w b for each plane. */
static inline ray_points project(__global const real *source, ray_points shift, real x, real y)
{
    ray_points p;
    p.x = shift.x + (source[0] * x + (source[1] * y + source[2]));
    p.y = shift.y + (source[3] * x + (source[4] * y + source[5]));
    p.z = shift.z + (source[6] * x + (source[7] * y + source[8]));
    return p;
}

/* All bits set where the position lies in the image and in front of its camera. */
static inline lane_int is_inside(ray_points p, real width, real height)
{
    return (p.z > (lane)0) & (p.x >= (lane)0) & (p.y >= (lane)0) & (p.x <= width * p.z)
        & (p.y <= height * p.z);
}

/* The grey value there, rounded to a whole number. */
static inline lane sample(__global const int *pairs, int width, int height, ray_points p)
{
    const lane inverse = 1 / p.z;
    const lane value = between_pixels(
        pairs, width, height, p.x * inverse - 0.5f, p.y * inverse - 0.5f);
    return (value + ROUNDER) - ROUNDER;
}

/* 127.5 (1 - ZNCC); `noise` is added to both variances, so that flat patches match nothing well. */
static inline lane dissimilarity(lane sum, lane squares, lane products, float4 window, real noise)
{
    const real n = window.y, floor_variance = n * n * noise;
    const lane variance = n * squares - sum * sum + floor_variance;
    const lane covariance = n * products - sum * window.z;
    const lane cost = 127.5f
        - 127.5f * covariance / lane_sqrt(variance * (window.w + floor_variance));
    return LANE_MIN((lane)255, LANE_MAX((lane)0, cost));
}

/* One source view's samples of the last WINDOW rows, and their sums in each column: of the samples, of
 * their squares, and of their products with the reference image. */
typedef struct {
    ray_points shift;
    lane recent[WINDOW][COLUMNS];
    lane sums[COLUMNS], squares[COLUMNS], products[COLUMNS];
} sweep_state;

static inline void start(sweep_state *state, __global const real *source, lane inverse_depths)
{
    state->shift.x = inverse_depths * source[9];
    state->shift.y = inverse_depths * source[10];
    state->shift.z = inverse_depths * source[11];
    for (int i = 0; i < COLUMNS; i++) {
        state->sums[i] = state->squares[i] = state->products[i] = (lane)0;
        for (int r = 0; r < WINDOW; r++)
            state->recent[r][i] = (lane)0;
    }
}

/* Replace in column i's sums the sample WINDOW rows above by the new one. */
static inline void exchange(
    sweep_state *state, int slot, int i, lane fresh, real grey, real old_grey)
{
    const lane old = state->recent[slot][i];
    state->recent[slot][i] = fresh;
    state->sums[i] += fresh - old;
    state->squares[i] += fresh * fresh - old * old;
    state->products[i] += fresh * grey - old * old_grey;
}

/* Warp row y of one source view, and compare the row RADIUS above it if it lies in the tile, which
 * begins at (x0, y0) and ends before x1. Costs enter `lowest` and `second`, one for each column. */
static inline void sweep_row(
    sweep_state *state, __global const int *image, __global const int *layout,
    __global const float4 *windows, __global const real *source, int width, int height, int x0,
    int x1, int y0, int y, int slot, real noise, lane *lowest, lane *second)
{
    const int done = y - RADIUS; /* the row whose windows end here */
    const int left_above = y - WINDOW; /* the row that leaves the windows */
    lane sum = (lane)0, square = (lane)0, product = (lane)0;
    for (int i = 0; i < COLUMNS; i++) {
        const int x = x0 - RADIUS + i;
        if (x >= 0 && x < width) {
            lane fresh = (lane)0;
            real grey = 0, old_grey = 0;
            if (y >= 0 && y < height) {
                const ray_points p = project(source, state->shift, x + 0.5f, y + 0.5f);
                fresh = sample(image, layout[1], layout[2], p);
                grey = windows[(size_t)y * width + x].x;
            }
            if (left_above >= 0 && left_above >= y0 - RADIUS)
                old_grey = windows[(size_t)left_above * width + x].x;
            exchange(state, slot, i, fresh, grey, old_grey);
        }
        sum += state->sums[i];
        square += state->squares[i];
        product += state->products[i];
        const int first = i - 2 * RADIUS; /* the column where this window begins */
        if (first < 0)
            continue;
        const int center = x0 + first;
        if (done >= y0 && center < x1) {
            const float4 window = windows[(size_t)done * width + center];
            const ray_points p = project(source, state->shift, center + 0.5f, done + 0.5f);
            const lane cost = is_inside(p, layout[1], layout[2])
                ? dissimilarity(sum, square, product, window, noise)
                : (lane)NOT_SEEN;
            const lane larger = LANE_MAX(lowest[first], cost);
            lowest[first] = LANE_MIN(lowest[first], cost);
            second[first] = LANE_MIN(second[first], larger);
        }
        sum -= state->sums[first];
        square -= state->squares[first];
        product -= state->products[first];
    }
}

/* The costs of LANES planes, from `plane` on, over the tile that begins at (x0, y0). */
static inline void sweep_tile(
    __global const int *pairs, __global const float4 *windows, __global const real *sources,
    __global const int *layout, __global const real *inverse_depths, __global uchar *costs,
    int width, int height, real noise, real second_share, int plane, int planes, int x0, int y0)
{
    const int x1 = min(x0 + TILE_WIDTH, width), y1 = min(y0 + TILE_HEIGHT, height);
    const lane depths = LOAD_GLOBAL(inverse_depths + plane);
    const lane unseen = depths == depths ? (lane)UNKNOWN : (lane)NO_PLANE;
    lane lowest[TILE_WIDTH], second[TILE_WIDTH]; /* costs of the two views that match best */
    sweep_state states[SOURCES];
    for (int s = 0; s < SOURCES; s++)
        start(&states[s], sources + s * SOURCE_NUMBERS, depths);

    for (int y = y0 - RADIUS, slot = 0; y < y1 + RADIUS; y++) {
        for (int i = 0; i < TILE_WIDTH; i++)
            lowest[i] = second[i] = (lane)NOT_SEEN;
        for (int s = 0; s < SOURCES; s++) {
            __global const int *place = layout + s * SOURCE_LAYOUT;
            sweep_row(
                &states[s], pairs + place[0], place, windows, sources + s * SOURCE_NUMBERS, width,
                height, x0, x1, y0, y, slot, noise, lowest, second);
        }
        slot = slot + 1 < WINDOW ? slot + 1 : 0;
        for (int x = x0; x < x1 && y - RADIUS >= y0; x++) {
            const lane best = lowest[x - x0], next = second[x - x0];
            lane cost = next < NOT_SEEN ? best + second_share * (next - best) : best;
            cost = best < NOT_SEEN ? cost + 0.5f : unseen;
            __global uchar *to = costs + ((size_t)(y - RADIUS) * width + x) * planes + plane;
            *(__global lane_bytes *)to = TO_BYTES(cost);
        }
    }
}

__kernel void plane_sweep(
    __global const int *pairs, __global const float4 *windows, __global const real *sources,
    __global const int *layout, __global const real *inverse_depths, __global uchar *costs,
    int width, int height, real noise, real second_share)
{
    const int planes = get_global_size(0) * PLANES_PER_ITEM;
    const int first = get_global_id(0) * PLANES_PER_ITEM;
    const int x0 = get_global_id(1) * TILE_WIDTH, y0 = get_global_id(2) * TILE_HEIGHT;
    for (int plane = first; plane < first + PLANES_PER_ITEM; plane += LANES)
        sweep_tile(
            pairs, windows, sources, layout, inverse_depths, costs, width, height, noise,
            second_share, plane, planes, x0, y0);
}
