/* The cost of a plane. Twin: tests/core_rasterizer/patch_match_oracle.py.
 *
 * A pixel x at inverse depth w appears in a source view at A x + w b (homogeneous; plane_sweep.cl), hence
 * a window on a plane appears at p + u r + v d, with three vectors that are computed once.
 *
 * Numbers of a source: A row by row and b, then the same from the source to the reference. Layout: offset
 * of its image in `pairs` (pixel_pairs.cl), width, height, offset of its inverse depths in `known`.
 */

/* SOURCE_NUMBERS and SOURCE_LAYOUT come from patch_level.py. */
#define NOISE 4e-6f /* variance of grey values that counts as no texture */
/* Pixels of disagreement without cost, because depths are read without interpolation. */
#define FORGIVEN 1.0f
#define MAX_MISSED 3.0f /* pixels; larger disagreements cost the same */
#define WORST 2.0f /* cost of NCC = -1, and where a view does not see the point */

/* The views to compare with. */
typedef struct {
    __global const int *pairs;
    __global const real *known, *numbers;
    __global const int *layout;
    int count;
    real agreement; /* cost per pixel of disagreement; 0: not computed */
} source_views;

/* 1 - NCC of the windows, in [0, 2]. NOISE is added to both variances, so that flat patches match nothing. */
static inline lane photometric_cost(const window *here, plane on, const source_views *views, int s)
{
    __global const real *m = views->numbers + s * SOURCE_NUMBERS;
    __global const int *layout = views->layout + s * SOURCE_LAYOUT;
    const int width = layout[1], height = layout[2];
    const lane z = m[6] * here->x + m[7] * here->y + m[8] + on.nearness * m[11];
    const lane x = m[0] * here->x + m[1] * here->y + m[2] + on.nearness * m[9];
    const lane y = m[3] * here->x + m[4] * here->y + m[5] + on.nearness * m[10];
    const lane_int seen = (z > (lane)0) & (x >= (lane)0) & (y >= (lane)0) & (x <= (real)width * z)
        & (y <= (real)height * z);
    if (!in_any_lane(seen))
        return (lane)WORST;
    /* Samples are interpolated between pixel centres, so half a pixel is subtracted. */
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
            const lane value = (1.0f / LEVELS)
                * between_pixels(views->pairs + layout[0], width, height,
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

/* The cost of the reprojection error of a pixel to a source view, onto its known surface, and back: at most
 * MAX_MISSED pixels, also where not visible (geometric consistency of Xu and Tao, CVPR 2019). */
static inline lane disagreement(const window *here, lane nearness, const source_views *views, int s)
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
    const lane_int known_there = seen & (back_z > (lane)0) & (missed < (lane)MAX_MISSED);
    return views->agreement * (known_there ? LANE_MAX(missed, (lane)0) : (lane)MAX_MISSED);
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
