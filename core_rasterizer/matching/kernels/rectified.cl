/* Matching costs of rectified pairs: volumes [height][width][depth] of uchar, disparity innermost.
 * Twin: tests/core_rasterizer/matching_oracle.py.
 *
 * Disparity d compares the left column x with the right column x - d. Maps of the right image are stored
 * mirrored, so that the lanes of a vector, neighbouring disparities, read neighbouring numbers: column
 * x - d is at width - 1 - x + d. They are padded to the largest such index. Disparities from `planes` on
 * are padding and cost 255; matches outside the right image cost `unseen`.
 */

#if LANES == 1
#define STORE_COSTS(pointer, value) (*(pointer) = (uchar)(value))
#else
typedef GLUE(uchar, LANES) lane_bytes;
#define STORE_COSTS(pointer, value)                                                                \
    (*(__global lane_bytes *)(pointer) = __builtin_convertvector(value, lane_bytes))
#endif

/* 0 .. LANES - 1. */
static inline lane_int lane_numbers(void)
{
    lane_int numbers = (lane_int)0;
    for (int l = 0; l < LANES; l++)
        ((int *)&numbers)[l] = l;
    return numbers;
}

/* Write costs in [0, 255] for the disparities from d on. */
static inline void write_costs(
    __global uchar *costs, size_t pixel, int depth, int planes, int unseen, int x, int d, lane cost)
{
    const lane_int disparity = lane_numbers() + d;
    const lane_int rounded = TO_INT(cost + (real)0.5);
    const lane_int seen = disparity <= x ? rounded : (lane_int)unseen;
    const lane_int filled = disparity < planes ? seen : (lane_int)255;
    STORE_COSTS(costs + pixel * depth + d, filled);
}

static inline lane correlation_cost(lane correlation)
{
    const lane bounded = LANE_MAX((lane)-1, LANE_MIN((lane)1, correlation));
    return (real)127.5 * (1 - bounded);
}

/* The sum over a window's row of left times right. Grey values are small whole numbers, so every
 * sum over a window is exact, and adding and subtracting rows causes no error. */
static inline lane row_product(__global const real *left, __global const real *right)
{
    lane sum = (lane)0;
#pragma unroll
    for (int k = 0; k <= 2 * RADIUS; k++)
        sum += left[k] * LOAD_GLOBAL(right + 2 * RADIUS - k);
    return sum;
}

/* Zero-mean normalized cross-correlation. Images are padded by RADIUS on every side. A work-item walks
 * down `rows` rows of one column. `scale` is one over the deviation, `sum` and `mean` of the window. */
__kernel void correlate_windows(
    __global const real *left, __global const real *right, __global const real *left_sum,
    __global const real *left_scale, __global const real *right_mean,
    __global const real *right_scale, __global uchar *costs, int height, int width, int planes,
    int depth, int unseen, int rows)
{
    const int d = get_global_id(0) * LANES, x = get_global_id(1);
    const int first = get_global_id(2) * rows, end = LANE_MIN(height, first + rows);
    const size_t right_width = width + depth;
    const size_t left_stride = width + 2 * RADIUS, right_stride = right_width + 2 * RADIUS;
    const int mirrored = width - 1 - x + d;
    left += x;
    right += mirrored;
    lane product = (lane)0;
    for (int y = first; y < first + 2 * RADIUS; y++)
        product += row_product(left + y * left_stride, right + y * right_stride);
    for (int y = first; y < end; y++) {
        const size_t low = y + 2 * RADIUS;
        product += row_product(left + low * left_stride, right + low * right_stride);
        const size_t pixel = (size_t)y * width + x, match = y * right_width + mirrored;
        const lane covariance = product - left_sum[pixel] * LOAD_GLOBAL(right_mean + match);
        const lane scale = left_scale[pixel] * LOAD_GLOBAL(right_scale + match);
        write_costs(
            costs, pixel, depth, planes, unseen, x, d, correlation_cost(covariance * scale));
        product -= row_product(left + y * left_stride, right + y * right_stride);
    }
}

/* One minus the dot product of feature vectors; maps are [height][channels][width or width + depth]. */
__kernel void correlate_features(
    __global const real *left, __global const real *right, __global uchar *costs, int channels,
    int width, int planes, int depth, int unseen)
{
    const int d = get_global_id(0) * LANES, x = get_global_id(1), y = get_global_id(2);
    const size_t right_width = width + depth;
    left += (size_t)y * channels * width + x;
    right += y * channels * right_width + width - 1 - x + d;
    lane product = (lane)0;
    for (int c = 0; c < channels; c++)
        product += left[c * width] * LOAD_GLOBAL(right + c * right_width);
    write_costs(
        costs, (size_t)y * width + x, depth, planes, unseen, x, d, correlation_cost(product));
}

/* Number of set bits. */
static inline int bits_set(ulong x)
{
    x -= (x >> 1) & 0x5555555555555555UL;
    x = (x & 0x3333333333333333UL) + ((x >> 2) & 0x3333333333333333UL);
    x = (x + (x >> 4)) & 0x0F0F0F0F0F0F0F0FUL;
    return (x * 0x0101010101010101UL) >> 56;
}

/* The share of BITS signs in which two census transforms differ. Work-items of a pixel share its
 * disparities; on a CPU there is one. */
__kernel void compare_signs(
    __global const long *left, __global const long *right, __global uchar *costs, int width,
    int planes, int depth, int unseen, int bits)
{
    const int x = get_global_id(1), y = get_global_id(2);
    const size_t pixel = (size_t)y * width + x;
    const ulong signs = left[pixel];
    right += (size_t)y * (width + depth) + width - 1 - x;
    for (int d = get_global_id(0) * LANES; d < depth; d += get_global_size(0) * LANES) {
        lane differing = (lane)0;
        for (int l = 0; l < LANES; l++)
            LANE_AT(differing, l) = bits_set(signs ^ right[d + l]);
        write_costs(costs, pixel, depth, planes, unseen, x, d, differing * ((real)255 / bits));
    }
}

/* The right image's costs: its column x at disparity d is the left column x + d at d. Past the edge
 * of the left image it takes the costs of column 0, which has no match at d >= 1. As above, the work-items
 * of a pixel share its disparities. */
__kernel void costs_of_right(
    __global const uchar *left_costs, __global uchar *right_costs, int width, int depth)
{
    const int x = get_global_id(1), step = get_global_size(0), seen = LANE_MIN(depth, width - x);
    const size_t row = (size_t)get_global_id(2) * width * depth, pixel = row + (size_t)x * depth;
    int d = get_global_id(0);
    for (; d < seen; d += step)
        right_costs[pixel + d] = left_costs[pixel + (size_t)d * (depth + 1)];
    for (; d < depth; d += step)
        right_costs[pixel + d] = left_costs[row + d];
}
