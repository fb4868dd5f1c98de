/* The cost volume of a plane sweep over unit feature vectors.
 * Twin: tests/core_rasterizer/plane_sweep_oracle.py.
 *
 * A lane is one of LANES neighbouring channels; CHANNELS is a multiple of LANES. Positions are as in
 * plane_sweep.cl. A work-item compares one pixel on PLANES_PER_ITEM neighbouring planes, whose samples
 * lie side by side in a source view.
 */

/* SOURCE_NUMBERS and SOURCE_LAYOUT come from sweep_geometry.py. */
#define NO_PLANE 255
#define UNKNOWN 128

/* <here, the features at (u, v)>, those taken between the four nearest pixel centres. */
static inline real similarity(
    __global const real *here, __global const real *features, int width, int height, real u, real v)
{
    u = clamp(u - (real)0.5, (real)0, (real)(width - 1));
    v = clamp(v - (real)0.5, (real)0, (real)(height - 1));
    const int left = (int)u, top = (int)v;
    const real right_share = u - left, lower_share = v - top;
    const size_t step_x = left + 1 < width ? CHANNELS : 0;
    const size_t step_y = top + 1 < height ? (size_t)width * CHANNELS : 0;
    __global const real *upper = features + ((size_t)top * width + left) * CHANNELS;
    __global const real *lower = upper + step_y;
    lane sum = (lane)0;
    for (int c = 0; c < CHANNELS; c += LANES) {
        const lane above = LOAD_GLOBAL(upper + c)
            + right_share * (LOAD_GLOBAL(upper + step_x + c) - LOAD_GLOBAL(upper + c));
        const lane below = LOAD_GLOBAL(lower + c)
            + right_share * (LOAD_GLOBAL(lower + step_x + c) - LOAD_GLOBAL(lower + c));
        sum += LOAD_GLOBAL(here + c) * (above + lower_share * (below - above));
    }
    real total = 0;
    for (int l = 0; l < LANES; l++)
        total += LANE_AT(sum, l);
    return total;
}

static inline uchar cost_at(
    __global const real *here, __global const real *features, __global const real *sources,
    __global const int *layout, real x, real y, real inverse_depth, real second_share)
{
    real best = -2, second = -2; /* below every similarity: not seen */
    for (int s = 0; s < SOURCES; s++) {
        __global const real *m = sources + s * SOURCE_NUMBERS;
        const real px = m[0] * x + m[1] * y + m[2] + inverse_depth * m[9];
        const real py = m[3] * x + m[4] * y + m[5] + inverse_depth * m[10];
        const real pz = m[6] * x + m[7] * y + m[8] + inverse_depth * m[11];
        const int width = layout[s * SOURCE_LAYOUT + 1], height = layout[s * SOURCE_LAYOUT + 2];
        const bool seen = pz > 0 && px >= 0 && py >= 0 && px <= width * pz && py <= height * pz;
        if (!seen)
            continue;
        __global const real *there = features + (size_t)layout[s * SOURCE_LAYOUT] * CHANNELS;
        const real found = similarity(here, there, width, height, px / pz, py / pz);
        second = max(second, min(best, found));
        best = max(best, found);
    }
    if (best < -1.5f)
        return inverse_depth == inverse_depth ? UNKNOWN : NO_PLANE;
    const real joint = second < -1.5f ? best : best + second_share * (second - best);
    return (uchar)(clamp((real)127.5 - (real)127.5 * joint, (real)0, (real)255) + (real)0.5);
}

__kernel void feature_sweep(
    __global const real *features, __global const real *sources, __global const int *layout,
    __global const real *inverse_depths, __global uchar *costs, int start, int width, int planes,
    real second_share)
{
    const int first = get_global_id(0) * PLANES_PER_ITEM;
    const int x = get_global_id(1), y = get_global_id(2);
    const size_t pixel = (size_t)y * width + x;
    __global const real *here = features + (start + pixel) * CHANNELS;
    for (int plane = first; plane < first + PLANES_PER_ITEM; plane++)
        costs[pixel * planes + plane] = cost_at(
            here, features, sources, layout, x + (real)0.5, y + (real)0.5, inverse_depths[plane],
            second_share);
}
