/* A step of PatchMatch: pixels adopt better planes of their neighbours, and try random changes.
 *
 * A pixel reads only planes of the other colour of a checkerboard, so the order of work-items does not
 * matter. See patch_plane.cl for planes and patch_costs.cl for their cost.
 */

#define MIN_WEIGHT 0.01f /* source views of lower weight are ignored */
#define BAD_COST 1.2f /* a view that costs more contradicts a plane */
#define GOOD_FALLOFF 5.556f /* 1 / (2 * 0.3^2), of the weight by cost */
#define IMPOSSIBLE 1000.0f /* above every cost */
#define REGIONS 8
#define HYPOTHESES (REGIONS + 1) /* the pixel's own plane is the last */

/* The cheapest pixel of a region so far, and its offset. */
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
    /* Beyond the image its own place: at the edge is a pixel of its colour, which another work-item writes. */
    const lane_int inside = (column >= 0) & (column < width);
    const lane_int at = inside ? row * width + column : y * width + x;
    const lane cost = gather_real(costs, at);
    const lane_int better = inside & (cost < best->cost);
    best->cost = better ? cost : best->cost;
    best->right = better ? (lane)right : best->right;
    best->down = better ? (lane)down : best->down;
    best->at = better ? at : best->at;
}

/* One plane of each of eight regions of the other colour: a V and a line in each direction, the plane
 * of lowest cost in each (adaptive checkerboard sampling of Xu and Tao, CVPR 2019). */
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
                consider(
                    costs, width, height, x, y, step * right + aside * down,
                    step * down + aside * right, &best);
            }
        plane there = load_plane(planes, pixels, best.at);
        there.nearness -= best.right * there.right + best.down * there.down;
        found[region] = either(best.cost < (lane)IMPOSSIBLE, there, own);
    }
}

/* How much each source view counts at the pixel: views that match most of the neighbouring planes well,
 * by how well (joint view selection of Xu and Tao, CVPR 2019). All others get a tiny weight, which decides
 * if no view is chosen. */
static inline void weigh_views(
    lane (*costs)[MAX_SOURCES], int sources, real good_cost, lane *weights)
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
        weights[s] = weights[s] < (lane)MIN_WEIGHT ? (lane)0 : weights[s];
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

/* The best of the pixel's own plane and its neighbours', by the views that match these; returns the
 * weights of the views. */
static inline void try_neighbours(
    search *state, const plane *found, const window *here, const source_views *views,
    real good_cost, lane *weights)
{
    lane costs[HYPOTHESES][MAX_SOURCES];
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
            cost += weights[s]
                * (photometric_cost(here, tried, views, s)
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
    lane weights[MAX_SOURCES];
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
            tried.nearness += (nearest - farthest) * step
                * (2 * uniform_draw(at, key, draw + 2) - 1);
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
