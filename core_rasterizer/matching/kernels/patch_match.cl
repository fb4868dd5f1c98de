/* PatchMatch stereo over slanted planes. Twin of the costs: tests/core_rasterizer/patch_match_oracle.py.
 *
 * A plane in space has an inverse depth w that is linear in the reference image, so it is kept as w at
 * the pixel's centre and its steps to the next pixel to the right and below. A pixel x at inverse depth w
 * appears in a source view at A x + w b (homogeneous; plane_sweep.cl), hence a window on a plane appears
 * at p + u r + v d with three vectors that are computed once: nothing else of the homography is needed.
 *
 * A lane is a pixel: LANES neighbours of one colour of a checkerboard, in one row. A pixel reads planes
 * of the other colour only, so that the order of work-items does not matter.
 *
 * `planes` holds four images one after the other: w, its step to the right, its step down, the cost.
 * A source's numbers are A row by row and b, then the same from the source to the reference; its layout
 * is where its image starts in `pairs` (sweep_images.cl), its width and height, and where its inverse
 * depths start in `known`.
 */

/* Windows are compared in every second pixel, like the fields of one colour of a chess board. */
#define SIDE (2 * RADIUS + 1)
#define SAMPLES ((SIDE * SIDE + 1) / 2)
#define FIRST_IN_ROW(v) (((v) + RADIUS) % 2 - RADIUS)
#define SOURCE_NUMBERS 24
#define SOURCE_LAYOUT 4
#define COLOR_FALLOFF 3.125f /* 1 / (2 * 0.4^2), for grey values in [-1, 1] */
#define NOISE 4e-6f /* variance of grey values that counts as no texture */
#define FORGIVEN 1.0f /* pixels by which views may disagree, since depths are read pixel by pixel */
#define MOST_MISSED 3.0f /* pixels; views that disagree by more are as wrong as any */
#define LEAST_WEIGHT 0.01f /* a source view of less is not asked */
#define BAD_COST 1.2f /* a view that costs more contradicts a plane */
#define GOOD_FALLOFF 5.556f /* 1 / (2 * 0.3^2): by which views of higher cost count less */
#define WORST 2.0f /* of NCC = -1, and where a view does not see the point */
#define IMPOSSIBLE 1000.0f /* above every cost */
#define REGIONS 8
#define HYPOTHESES (REGIONS + 1) /* the pixel's own plane is the last */

#if LANES == 1
typedef uint lane_uint;
#define AS_INT(x) ((int)(x))
#else
typedef GLUE(uint, LANES) lane_uint;
#define AS_INT(x) (*(const lane_int *)&(x))
#endif

typedef struct {
    lane nearness, right, down; /* inverse depth, and its steps to the neighbours */
} plane;

/* What a pixel's window needs of the reference image: weights of sum 1, the same times the grey value
 * less its mean, and the variance. */
typedef struct {
    lane x, y; /* of the pixel's centre */
    lane weights[SAMPLES], centered[SAMPLES];
    lane variance;
} window;

/* The views to compare with. */
typedef struct {
    __global const int *pairs;
    __global const real *known, *numbers;
    __global const int *layout;
    int count;
    real agreement; /* cost of a pixel by which views disagree; 0: nobody is asked */
} source_views;

static inline lane_int gather(__global const int *table, lane_int at)
{
#if LANES == 1
    return table[at];
#else
    return (lane_int)(table[at.s0], table[at.s1], table[at.s2], table[at.s3],
                      table[at.s4], table[at.s5], table[at.s6], table[at.s7]);
#endif
}

static inline lane gather_real(__global const real *table, lane_int at)
{
#if LANES == 1
    return table[at];
#else
    return (lane)(table[at.s0], table[at.s1], table[at.s2], table[at.s3],
                  table[at.s4], table[at.s5], table[at.s6], table[at.s7]);
#endif
}

static inline lane_int limited(lane_int value, int last)
{
    value = value < 0 ? (lane_int)0 : value;
    return value > last ? (lane_int)last : value;
}

static inline bool in_any_lane(lane_int mask)
{
    int found = 0;
    for (int i = 0; i < LANES; i++)
        found |= LANE_AT_INT(mask, i);
    return found != 0;
}

/* Columns of neighbouring lanes, `step` apart; those beyond the row repeat its last pixel of the kind. */
static inline lane_int columns(int first, int step, int width)
{
    lane_int x;
    for (int i = 0; i < LANES; i++)
        ((int *)&x)[i] = first + i * step < width ? first + i * step : first;
    return x;
}

/* A hash of 32 bits: each bit of the input changes each bit of the output half of the time. */
static inline lane_uint mixed(lane_uint x)
{
    x ^= x >> 16;
    x *= (lane_uint)0x7feb352du;
    x ^= x >> 15;
    x *= (lane_uint)0x846ca68bu;
    return x ^ (x >> 16);
}

/* A number in [0, 1) that depends on the pixel, a launch's key and the number of the draw alone. */
static inline lane uniform_draw(lane_int pixel, uint key, uint draw)
{
    const lane_uint x = mixed(mixed((*(const lane_uint *)&pixel) + key) + draw) >> 8;
    return FROM_INT(AS_INT(x)) * (1.0f / 16777216);
}

/* Weights fall with the distance and with the difference in grey, so that a window does not reach over
 * the edge of a surface (Schoenberger et al., ECCV 2016). */
static inline void look_around(
    __global const real *grey, int width, int height, lane_int x, int y, window *here)
{
    const lane middle = gather_real(grey, y * width + x);
    lane values[SAMPLES], total = (lane)0, mean = (lane)0;
    here->x = FROM_INT(x) + 0.5f;
    here->y = (lane)(y + 0.5f);
    for (int i = 0, v = -RADIUS; v <= RADIUS; v++) {
        const int row = clamp(y + v, 0, height - 1);
        const lane_int row_within = (lane_int)(row == y + v ? -1 : 0);
        for (int u = FIRST_IN_ROW(v); u <= RADIUS; u += 2, i++) {
            const lane_int column = x + u;
            const lane_int within = (column >= 0) & (column < width) & row_within;
            values[i] = gather_real(grey, row * width + limited(column, width - 1));
            const lane off = values[i] - middle;
            const real distance = (real)(u * u + v * v) / (2 * RADIUS * RADIUS);
            const lane weight = lane_exp(-off * off * COLOR_FALLOFF - distance);
            here->weights[i] = within ? weight : (lane)0;
            total += here->weights[i];
            mean += here->weights[i] * values[i];
        }
    }
    mean /= total;
    here->variance = (lane)0;
    for (int i = 0; i < SAMPLES; i++) {
        here->weights[i] /= total;
        here->centered[i] = here->weights[i] * (values[i] - mean);
        here->variance += here->centered[i] * (values[i] - mean);
    }
}

/* Between the four nearest pixels; positions outside take the border's. Comparisons turn NaN into 0. */
static inline lane sample(__global const int *pairs, int width, int height, lane u, lane v)
{
    u = LANE_MAX(u, (lane)0);
    v = LANE_MAX(v, (lane)0);
    u = LANE_MIN(u, (lane)(width - 1));
    v = LANE_MIN(v, (lane)(height - 1));
    const lane_int left = TO_INT(u), top = TO_INT(v);
    const lane_int at = top * width + left;
    const lane_int above = gather(pairs, at), below = gather(pairs + width, at);
    const lane part = u - FROM_INT(left);
    const lane upper = FROM_INT((above << 16) >> 16) + part * FROM_INT(above >> 16);
    const lane lower = FROM_INT((below << 16) >> 16) + part * FROM_INT(below >> 16);
    return (upper + (v - FROM_INT(top)) * (lower - upper)) * (1.0f / LEVELS);
}

/* 1 - NCC of the windows, in [0, 2]. NOISE is added to both variances: even patches match nothing. */
static inline lane photometric_cost(
    const window *here, plane on, const source_views *views, int s)
{
    __global const real *m = views->numbers + s * SOURCE_NUMBERS;
    __global const int *layout = views->layout + s * SOURCE_LAYOUT;
    const int width = layout[1], height = layout[2];
    const lane z = m[6] * here->x + m[7] * here->y + m[8] + on.nearness * m[11];
    const lane x = m[0] * here->x + m[1] * here->y + m[2] + on.nearness * m[9];
    const lane y = m[3] * here->x + m[4] * here->y + m[5] + on.nearness * m[10];
    const lane_int seen = (z > (lane)0) & (x >= (lane)0) & (y >= (lane)0)
        & (x <= (real)width * z) & (y <= (real)height * z);
    if (!in_any_lane(seen))
        return (lane)WORST;
    /* Half a pixel is taken off all three vectors, since samples lie between pixel centres. */
    const lane right_z = m[6] + on.right * m[11], down_z = m[7] + on.down * m[11];
    const lane right_x = m[0] + on.right * m[9] - 0.5f * right_z;
    const lane right_y = m[3] + on.right * m[10] - 0.5f * right_z;
    const lane down_x = m[1] + on.down * m[9] - 0.5f * down_z;
    const lane down_y = m[4] + on.down * m[10] - 0.5f * down_z;
    lane sum = (lane)0, squares = (lane)0, covariance = (lane)0;
    for (int i = 0, v = -RADIUS; v <= RADIUS; v++) {
        const lane row_x = x - 0.5f * z + (real)v * down_x;
        const lane row_y = y - 0.5f * z + (real)v * down_y;
        const lane row_z = z + (real)v * down_z;
        for (int u = FIRST_IN_ROW(v); u <= RADIUS; u += 2, i++) {
            const lane inverse = 1 / (row_z + (real)u * right_z);
            const lane value = sample(views->pairs + layout[0], width, height,
                                      (row_x + (real)u * right_x) * inverse,
                                      (row_y + (real)u * right_y) * inverse);
            const lane weighted = here->weights[i] * value;
            sum += weighted;
            squares += weighted * value;
            covariance += here->centered[i] * value;
        }
    }
    lane variance = squares - sum * sum;
    variance = LANE_MAX(variance, (lane)0) + NOISE;
    const lane cost = 1 - covariance / lane_sqrt(variance * (here->variance + NOISE));
    return seen ? LANE_MIN((lane)WORST, LANE_MAX((lane)0, cost)) : (lane)WORST;
}

/* What it costs by how many pixels the pixel misses itself on its way to a source view, onto the surface that is known
 * there, and back; at most MOST_MISSED, which it is where nothing is seen (geometric
 * consistency of Xu and Tao, CVPR 2019). */
static inline lane disagreement(
    const window *here, lane nearness, const source_views *views, int s)
{
    if (views->agreement == 0)
        return (lane)0;
    __global const real *m = views->numbers + s * SOURCE_NUMBERS;
    __global const int *layout = views->layout + s * SOURCE_LAYOUT;
    const int width = layout[1], height = layout[2];
    const lane z = m[6] * here->x + m[7] * here->y + m[8] + nearness * m[11];
    const lane u = (m[0] * here->x + m[1] * here->y + m[2] + nearness * m[9]) / z;
    const lane v = (m[3] * here->x + m[4] * here->y + m[5] + nearness * m[10]) / z;
    const lane_int seen = (z > (lane)0) & (u >= (lane)0) & (v >= (lane)0) & (u < (lane)width)
        & (v < (lane)height);
    const lane_int column = TO_INT(seen ? u : (lane)0), row = TO_INT(seen ? v : (lane)0);
    const lane there = gather_real(views->known + layout[3], row * width + column);
    m += SOURCE_NUMBERS / 2;
    const lane back_z = m[6] * u + m[7] * v + m[8] + there * m[11];
    const lane back_x = (m[0] * u + m[1] * v + m[2] + there * m[9]) / back_z - here->x;
    const lane back_y = (m[3] * u + m[4] * v + m[5] + there * m[10]) / back_z - here->y;
    const lane missed = lane_sqrt(back_x * back_x + back_y * back_y) - FORGIVEN;
    const lane_int known_there = seen & (back_z > (lane)0) & (missed < (lane)MOST_MISSED);
    return views->agreement * (known_there ? LANE_MAX(missed, (lane)0) : (lane)MOST_MISSED);
}

static inline plane load_plane(__global const real *planes, int pixels, lane_int at)
{
    plane p;
    p.nearness = gather_real(planes, at);
    p.right = gather_real(planes + pixels, at);
    p.down = gather_real(planes + 2 * pixels, at);
    return p;
}

static inline plane either(lane_int first, plane a, plane b)
{
    plane p;
    p.nearness = first ? a.nearness : b.nearness;
    p.right = first ? a.right : b.right;
    p.down = first ? a.down : b.down;
    return p;
}

/* The cheapest pixel so far of a region, and how far it is from the middle. */
typedef struct {
    lane cost, right, down;
    lane_int at;
} find;

static inline void consider(
    __global const real *costs, int width, int height, lane_int x, int y, int right, int down,
    find *best)
{
    const int row = y + down;
    const lane_int column = x + right;
    if (row < 0 || row >= height)
        return;
    const lane_int at = row * width + limited(column, width - 1);
    const lane cost = gather_real(costs, at);
    const lane_int better = (column >= 0) & (column < width) & (cost < best->cost);
    best->cost = better ? cost : best->cost;
    best->right = better ? (lane)right : best->right;
    best->down = better ? (lane)down : best->down;
    best->at = better ? at : best->at;
}

/* One plane of each of eight regions of the other colour: a V and a line in each direction, the plane
 * of lowest cost in each (adaptive checkerboard sampling of
 * Xu and Tao, CVPR 2019). */
static inline void neighbouring_planes(
    __global const real *planes, int width, int height, lane_int x, int y, plane own, plane *found)
{
    const int pixels = width * height;
    __global const real *costs = planes + 3 * pixels;
    for (int region = 0; region < REGIONS; region++) {
        const int sign = region & 1 ? 1 : -1, upright = (region >> 1) & 1, far = region >> 2;
        const int right = upright ? 0 : sign, down = upright ? sign : 0;
        find best = {(lane)IMPOSSIBLE, (lane)0, (lane)0, y * width + x};
        if (far)
            for (int step = 3; step <= 23; step += 2)
                consider(costs, width, height, x, y, step * right, step * down, &best);
        else
            for (int aside = -3; aside <= 3; aside++) {
                const int step = 1 + abs(aside);
                consider(costs, width, height, x, y, step * right + aside * down,
                         step * down + aside * right, &best);
            }
        plane there = load_plane(planes, pixels, best.at);
        there.nearness -= best.right * there.right + best.down * there.down;
        found[region] = either(best.cost < (lane)IMPOSSIBLE, there, own);
    }
}

/* How much each source view counts at the pixel: views that match most of the neighbouring planes well,
 * by how well (joint view selection of Xu and Tao, CVPR 2019). All others share next to nothing,
 * which decides where no view is chosen. */
static inline void weigh_views(lane (*costs)[MOST_SOURCES], int sources, real good_cost, lane *weights)
{
    for (int s = 0; s < sources; s++) {
        lane good = (lane)0, bad = (lane)0, sum = (lane)0, all = (lane)0;
        for (int k = 0; k < REGIONS; k++) {
            const lane cost = costs[k][s], worth = lane_exp(-cost * cost * GOOD_FALLOFF);
            const lane_int matches = cost < (lane)good_cost;
            good += matches ? (lane)1 : (lane)0;
            sum += matches ? worth : (lane)0;
            bad += cost > (lane)BAD_COST ? (lane)1 : (lane)0;
            all += worth;
        }
        const lane_int chosen = (good > (lane)2) & (bad < (lane)3);
        weights[s] = (chosen ? sum / good : (lane)0) + 1e-3f * all + 1e-6f;
    }
    lane total = (lane)0;
    for (int s = 0; s < sources; s++)
        total += weights[s];
    for (int s = 0; s < sources; s++) {
        weights[s] /= total;
        weights[s] = weights[s] < (lane)LEAST_WEIGHT ? (lane)0 : weights[s];
    }
}

/* A plane through the same point with its normal moved by up to `amount` of its length in each direction
 * of the camera's axes; the old one where it would be seen at less than six degrees. A plane's normal is
 * (fx right, fy down, w - the rest at the principal point); along the pixel's ray it has the length w. */
static inline plane tilted(plane p, lane amount, lane_int pixel, uint key, uint draw, lane ray_x,
                           lane ray_y, real focal_x, real focal_y)
{
    lane nx = focal_x * p.right, ny = focal_y * p.down;
    lane nz = p.nearness - nx * ray_x - ny * ray_y;
    const lane length = amount * lane_sqrt(nx * nx + ny * ny + nz * nz);
    nx += length * (2 * uniform_draw(pixel, key, draw) - 1);
    ny += length * (2 * uniform_draw(pixel, key, draw + 1) - 1);
    nz += length * (2 * uniform_draw(pixel, key, draw + 2) - 1);
    const lane along = nx * ray_x + ny * ray_y + nz;
    const lane squared = (nx * nx + ny * ny + nz * nz) * (ray_x * ray_x + ray_y * ray_y + 1);
    plane q = p;
    q.right = p.nearness * nx / (along * focal_x);
    q.down = p.nearness * ny / (along * focal_y);
    return either((along > (lane)0) & (along * along > 0.01f * squared), q, p);
}

/* Random planes, facing the camera at any angle. */
__kernel void draw_planes(
    __global real *planes, int width, int height, real farthest, real nearest, real focal_x,
    real focal_y, real center_x, real center_y, uint key)
{
    const int y = get_global_id(1), pixels = width * height;
    const int first = get_global_id(0) * LANES;
    const lane_int x = columns(first, 1, width);
    const lane_int at = y * width + x;
    const lane ray_x = (FROM_INT(x) + 0.5f - center_x) / focal_x;
    const lane ray_y = (lane)((y + 0.5f - center_y) / focal_y);
    plane p;
    p.nearness = farthest + (nearest - farthest) * uniform_draw(at, key, 0);
    p.right = p.down = (lane)0;
    p = tilted(p, (lane)1, at, key, 1, ray_x, ray_y, focal_x, focal_y);
    for (int i = 0; i < LANES && first + i < width; i++) {
        __global real *to = planes + y * width + first + i;
        to[0] = LANE_AT(p.nearness, i);
        to[pixels] = LANE_AT(p.right, i);
        to[2 * pixels] = LANE_AT(p.down, i);
    }
}

/* The photometric cost of each pixel's plane in each source view, [sources, H, W]. */
__kernel void plane_costs(
    __global const real *planes, __global const real *grey, __global const int *pairs,
    __global const real *known, __global const real *numbers, __global const int *layout,
    __global real *costs, int sources, int width, int height)
{
    const int y = get_global_id(1), first = get_global_id(0) * LANES, pixels = width * height;
    const lane_int x = columns(first, 1, width);
    const source_views views = {pairs, known, numbers, layout, sources, 0};
    const plane own = load_plane(planes, pixels, y * width + x);
    window here;
    look_around(grey, width, height, x, y, &here);
    for (int s = 0; s < sources; s++) {
        const lane cost = photometric_cost(&here, own, &views, s);
        for (int i = 0; i < LANES && first + i < width; i++)
            costs[s * pixels + y * width + first + i] = LANE_AT(cost, i);
    }
}

/* The best plane so far, its cost, and the inverse depths between which planes lie. */
typedef struct {
    plane best;
    lane lowest;
    real farthest, nearest;
} search;

static inline void try_plane(search *state, plane tried, lane cost)
{
    const lane_int better = (cost < state->lowest) & (tried.nearness >= (lane)state->farthest)
        & (tried.nearness <= (lane)state->nearest);
    state->best = either(better, tried, state->best);
    state->lowest = better ? cost : state->lowest;
}

/* The best of the pixel's own plane and its neighbours', by the views that match these; tells how much
 * each view counted. */
static inline void try_neighbours(
    search *state, const plane *found, const window *here, const source_views *views,
    real good_cost, lane *weights)
{
    lane costs[HYPOTHESES][MOST_SOURCES];
    for (int k = 0; k < HYPOTHESES; k++)
        for (int s = 0; s < views->count; s++)
            costs[k][s] = photometric_cost(here, found[k], views, s);
    weigh_views(costs, views->count, good_cost, weights);
    for (int k = REGIONS; k >= 0; k--) { /* its own first: others must be better */
        lane cost = (lane)0;
        for (int s = 0; s < views->count; s++)
            cost += weights[s] * (costs[k][s] + disagreement(here, found[k].nearness, views, s));
        try_plane(state, found[k], cost);
    }
}

static inline lane weighted_cost(
    plane tried, const window *here, const source_views *views, const lane *weights)
{
    lane cost = (lane)0;
    for (int s = 0; s < views->count; s++)
        if (in_any_lane(weights[s] > (lane)0))
            cost += weights[s] * (photometric_cost(here, tried, views, s)
                                  + disagreement(here, tried.nearness, views, s));
    return cost;
}

/* One colour of the checkerboard: each pixel takes the best of its own plane, those of its neighbours,
 * and three changes of the best one: of its depth, of its normal, of both. Changes are of all sizes: as
 * many between 1/8 and 1/16 of the range as between 1/512 and 1/1024. */
__kernel void improve_planes(
    __global real *planes, __global const real *grey, __global const int *pairs,
    __global const real *known, __global const real *numbers, __global const int *layout,
    int sources, int width, int height, real farthest, real nearest, real focal_x, real focal_y,
    real center_x, real center_y, real good_cost, real agreement, int colour, uint key)
{
    const int y = get_global_id(1), pixels = width * height;
    const int first = 2 * LANES * get_global_id(0) + ((y + colour) & 1);
    if (first >= width)
        return;
    const lane_int x = columns(first, 2, width), at = y * width + x;
    const source_views views = {pairs, known, numbers, layout, sources, agreement};
    plane found[HYPOTHESES];
    lane weights[MOST_SOURCES];
    window here;

    found[REGIONS] = load_plane(planes, pixels, at);
    neighbouring_planes(planes, width, height, x, y, found[REGIONS], found);
    look_around(grey, width, height, x, y, &here);
    search state = {found[REGIONS], (lane)IMPOSSIBLE, farthest, nearest};
    try_neighbours(&state, found, &here, &views, good_cost, weights);

    const lane ray_x = (here.x - center_x) / focal_x, ray_y = (here.y - center_y) / focal_y;
    for (int change = 0; change < 3; change++) {
        const uint draw = 8 * change;
        const lane step = lane_exp(-2.0f - 5.5f * uniform_draw(at, key, draw));
        const lane tilt = lane_exp(-3.5f * uniform_draw(at, key, draw + 1));
        plane tried = state.best;
        if (change != 1)
            tried.nearness += (nearest - farthest) * step * (2 * uniform_draw(at, key, draw + 2) - 1);
        if (change != 0)
            tried = tilted(tried, tilt, at, key, draw + 3, ray_x, ray_y, focal_x, focal_y);
        try_plane(&state, tried, weighted_cost(tried, &here, &views, weights));
    }

    for (int i = 0; i < LANES && first + 2 * i < width; i++) {
        __global real *to = planes + y * width + first + 2 * i;
        to[0] = LANE_AT(state.best.nearness, i);
        to[pixels] = LANE_AT(state.best.right, i);
        to[2 * pixels] = LANE_AT(state.best.down, i);
        to[3 * pixels] = LANE_AT(state.lowest, i);
    }
}
