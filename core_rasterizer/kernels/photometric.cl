/* L1 + D-SSIM: the loss and its gradient image. Twin: tests/core_rasterizer/test_photometric.py.
 *
 * An image row is `row` = 3 * width interleaved reals, and the channels never mix, so that a vector
 * lane is simply the next real and a horizontal neighbour is CHANNELS reals away. The 11 x 11 window
 * is separable; four kernels run one after another:
 *
 *   filter_columns       windows of x, x - y, (x - y)^2 and x y, downwards
 *   dissimilarity        the same sideways; 1 - SSIM at every pixel and its three derivatives
 *   filter_derivatives   windows of the derivatives, downwards
 *   gradient             the same sideways; the chain rule back to x
 *
 * Filtered maps have `stride` reals a row: BORDER zeros before and after the image stand for the
 * window's zero padding, are never written, and save every test for the left and right edge.
 *
 * Everything is told in differences x - y, with e = mu_x - mu_y and v = the variance of x - y:
 *   1 - SSIM = e^2 / d1 + (n1 / d1) (v / d2),  d1 = n1 + e^2,  d2 = n2 + v,
 *   n1 = 2 mu_x mu_y + C1,  n2 = 2 cov(x, y) + C2.
 * It is algebraically the usual formula, but nothing cancels as x approaches y: equal images give 0,
 * and a gradient of 0, to the last bit.
 *
 * A row's last block is moved left until it ends with the row, so it overlaps the block before; the
 * overlapping lanes are computed twice, with the same result, and counted once. `row` >= LANES.
 */

#define CHANNELS 3
#define RADIUS 5
#define TAPS (2 * RADIUS + 1)
#define BORDER (RADIUS * CHANNELS)
#define ROWS 2 /* image rows that a work-item filters at once: each loaded row serves both */
#define C1 ((real)0.0001)
#define C2 ((real)0.0009)

/* exp(-k^2 / (2 * 1.5^2)) for k = -5 .. 5, divided by their sum. */
__constant real window[TAPS] = {
    (real)0.00102838008447911, (real)0.00759875813523919, (real)0.0360007721284308,
    (real)0.109360689509700,   (real)0.213005537711254,   (real)0.266011724861794,
    (real)0.213005537711254,   (real)0.109360689509700,   (real)0.0360007721284308,
    (real)0.00759875813523919, (real)0.00102838008447911};

/* Where this work-item's next block starts; see the note on a row's last block. */
#define FOR_EACH_BLOCK(block, row) \
    for (int block = get_global_id(0) * LANES; block < (row); block += get_global_size(0) * LANES)
#define BLOCK_START(block, row) ((block) < (row) - LANES ? (block) : (row) - LANES)

static inline lane filter_row(__global const real *map)
{
    lane sum = (lane)0;
#pragma unroll
    for (int k = 0; k < TAPS; k++)
        sum += window[k] * LOAD_GLOBAL(map + CHANNELS * (k - RADIUS));
    return sum;
}

/* 0 in the lanes that a row's last block shares with the block before, 1 in the others. */
static inline lane lanes_of_last_block(int row)
{
    lane own = (lane)1;
    for (int l = 0; l < LANES - 1 - (row - 1) % LANES; l++)
        LANE_AT(own, l) = 0;
    return own;
}

static inline real sum_lanes(lane values)
{
    real sum = 0;
    for (int l = 0; l < LANES; l++)
        sum += LANE_AT(values, l);
    return sum;
}

__kernel void filter_columns(
    __global const real *image, __global const real *target, __global real *maps,
    int height, int row, int stride)
{
    const size_t plane = (size_t)height * stride;
    const int top = get_global_id(1) * ROWS;
    FOR_EACH_BLOCK(block, row) {
        const int start = BLOCK_START(block, row);
        lane mean[ROWS], difference[ROWS], square[ROWS], product[ROWS];
        for (int r = 0; r < ROWS; r++)
            mean[r] = difference[r] = square[r] = product[r] = (lane)0;
#pragma unroll
        for (int t = 0; t < TAPS + ROWS - 1; t++) {
            /* Rows outside the image count as zero without a branch, which would stop unrolling. */
            const int wanted = top + t - RADIUS;
            const int y = wanted < 0 ? 0 : wanted >= height ? height - 1 : wanted;
            const real inside = y == wanted;
            const lane a = inside * LOAD_GLOBAL(image + (size_t)y * row + start);
            const lane d = a - inside * LOAD_GLOBAL(target + (size_t)y * row + start);
            const lane dd = d * d, ab = a * (a - d);
#pragma unroll
            for (int r = 0; r < ROWS; r++) {
                if (t < r || t - r >= TAPS)
                    continue;
                const real weight = window[t - r];
                mean[r] += weight * a;
                difference[r] += weight * d;
                square[r] += weight * dd;
                product[r] += weight * ab;
            }
        }
        for (int r = 0; r < ROWS && top + r < height; r++) {
            __global real *map = maps + (size_t)(top + r) * stride + BORDER + start;
            STORE_GLOBAL(map, mean[r]);
            STORE_GLOBAL(map + plane, difference[r]);
            STORE_GLOBAL(map + 2 * plane, square[r]);
            STORE_GLOBAL(map + 3 * plane, product[r]);
        }
    }
}

/* Writes two partial sums a work-item: of |x - y| and of 1 - SSIM. */
__kernel void dissimilarity(
    __global const real *image, __global const real *target, __global const real *maps,
    __global real *derivatives, __global real *sums, int height, int row, int stride)
{
    const size_t plane = (size_t)height * stride;
    const int y = get_global_id(1);
    const lane last = lanes_of_last_block(row);
    lane absolute = (lane)0, structural = (lane)0;
    FOR_EACH_BLOCK(block, row) {
        const int start = BLOCK_START(block, row);
        const size_t at = (size_t)y * stride + BORDER + start;
        const lane mean = filter_row(maps + at);
        const lane e = filter_row(maps + plane + at);
        const lane square = filter_row(maps + 2 * plane + at);
        const lane product = filter_row(maps + 3 * plane + at);

        const lane means = mean * (mean - e), ee = e * e;
        const lane n1 = 2 * means + C1, n2 = 2 * (product - means) + C2;
        const lane v = square - ee;
        const lane d1 = n1 + ee, d2 = n2 + v;
        const lane inverse1 = 1 / d1, inverse2 = 1 / d2;
        const lane lost = ee * inverse1 + n1 * inverse1 * v * inverse2;

        /* SSIM as a function of the windows of x, (x - y)^2 and x y, with those of y held. */
        const lane by_mean =
            2 * inverse1 * inverse2 * ((n2 - n1) * (lost * mean - e) - (1 - lost) * mean * (v - ee));
        const lane by_square = (lost - 1) * inverse2;
        const lane by_product = 2 * n1 * inverse1 * v * inverse2 * inverse2;
        STORE_GLOBAL(derivatives + at, by_mean);
        STORE_GLOBAL(derivatives + plane + at, by_square);
        STORE_GLOBAL(derivatives + 2 * plane + at, by_product);

        const size_t pixel = (size_t)y * row + start;
        const lane d = LOAD_GLOBAL(image + pixel) - LOAD_GLOBAL(target + pixel);
        const lane own = start == block ? (lane)1 : last;
        absolute += own * LANE_ABS(d);
        structural += own * lost;
    }
    const size_t slot = 2 * (y * get_global_size(0) + get_global_id(0));
    sums[slot] = sum_lanes(absolute);
    sums[slot + 1] = sum_lanes(structural);
}

__kernel void filter_derivatives(
    __global const real *derivatives, __global real *maps, int height, int row, int stride)
{
    const size_t plane = (size_t)height * stride;
    const int top = get_global_id(1) * ROWS;
    FOR_EACH_BLOCK(block, row) {
        const int start = BORDER + BLOCK_START(block, row);
        lane sum0[ROWS], sum1[ROWS], sum2[ROWS];
        for (int r = 0; r < ROWS; r++)
            sum0[r] = sum1[r] = sum2[r] = (lane)0;
#pragma unroll
        for (int t = 0; t < TAPS + ROWS - 1; t++) {
            const int wanted = top + t - RADIUS;
            const int y = wanted < 0 ? 0 : wanted >= height ? height - 1 : wanted;
            const real inside = y == wanted;
            __global const real *from = derivatives + (size_t)y * stride + start;
            const lane value0 = inside * LOAD_GLOBAL(from);
            const lane value1 = inside * LOAD_GLOBAL(from + plane);
            const lane value2 = inside * LOAD_GLOBAL(from + 2 * plane);
#pragma unroll
            for (int r = 0; r < ROWS; r++) {
                if (t < r || t - r >= TAPS)
                    continue;
                const real weight = window[t - r];
                sum0[r] += weight * value0;
                sum1[r] += weight * value1;
                sum2[r] += weight * value2;
            }
        }
        for (int r = 0; r < ROWS && top + r < height; r++) {
            __global real *map = maps + (size_t)(top + r) * stride + start;
            STORE_GLOBAL(map, sum0[r]);
            STORE_GLOBAL(map + plane, sum1[r]);
            STORE_GLOBAL(map + 2 * plane, sum2[r]);
        }
    }
}

/* d loss / d x; the scales are the weights of the two terms over the number of reals in the image. */
__kernel void gradient(
    __global const real *image, __global const real *target, __global const real *maps,
    __global real *result, int height, int row, int stride, real l1_scale, real ssim_scale)
{
    const size_t plane = (size_t)height * stride;
    const int y = get_global_id(1);
    FOR_EACH_BLOCK(block, row) {
        const int start = BLOCK_START(block, row);
        const size_t at = (size_t)y * stride + BORDER + start;
        const size_t pixel = (size_t)y * row + start;
        const lane by_mean = filter_row(maps + at);
        const lane by_square = filter_row(maps + plane + at);
        const lane by_product = filter_row(maps + 2 * plane + at);
        const lane b = LOAD_GLOBAL(target + pixel);
        const lane d = LOAD_GLOBAL(image + pixel) - b;
        const lane sign = d > (lane)0 ? (lane)1 : d < (lane)0 ? (lane)-1 : (lane)0;
        const lane slope
            = l1_scale * sign - ssim_scale * (by_mean + 2 * d * by_square + b * by_product);
        /* Values beyond 1e12 may overflow on the way; what is undefined is no gradient. */
        STORE_GLOBAL(result + pixel, LANE_ABS(slope) < (lane)REAL_LARGEST ? slope : (lane)0);
    }
}
