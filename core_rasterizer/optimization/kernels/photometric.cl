/* L1 + D-SSIM on a CPU: the loss and its gradient image.
 *
 * An image row is `row` = 3 * width interleaved reals, and the channels never mix, so that a vector
 * lane is simply the next real and a horizontal neighbour is CHANNELS reals away. The 11 x 11 window
 * is separable. A work-item walks down one band of the image, ROWS rows a step, and in each step
 *
 *   filter_columns       windows of x, x - y, (x - y)^2 and x y, downwards, into `lines`
 *   dissimilarity        the same sideways; 1 - SSIM at every pixel, its three derivatives into `ring`
 *   filter_derivatives   windows of the derivatives, downwards, RADIUS rows behind, into `lines`
 *   gradient             the same sideways; the chain rule back to x
 *
 * so that intermediate results stay in the nearest caches. The first and last RADIUS rows of derivatives
 * are also computed by the neighbouring band; results do not depend on the bands.
 *
 * Rows of `lines` and `ring` have `stride` reals: BORDER zeros before and after the image stand for
 * the window's zero padding, are never written, and avoid tests for the left and right edge.
 *
 * A row's last block is moved left until it ends with the row, so it overlaps the block before; the
 * overlapping lanes are computed twice, with the same result, and counted once. `row` >= LANES.
 */

#define BORDER (RADIUS * CHANNELS)
/* ROWS: image rows of a step; each row that is loaded serves all. */
#define RING (TAPS + ROWS - 1) /* rows of derivatives that a step looks at */

/* Start of the next block; see the note on a row's last block. */
#define FOR_EACH_BLOCK(block, row) for (int block = 0; block < (row); block += LANES)
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

/* The wanted row, or if it is outside the image the nearest one with weight 0. A branch would prevent
 * unrolling. */
#define ROW_INSIDE(y, inside, wanted, height)                                                      \
    const int y = (wanted) < 0 ? 0 : (wanted) >= (height) ? (height) - 1 : (wanted);               \
    const real inside = y == (wanted)

/* Whether all rows of a step at row `top` are inside the image, as nearly always; the weights above are then
 * constant 1. */
#define ALL_INSIDE(top, height) ((top) >= RADIUS && (top) + ROWS - 1 + RADIUS < (height))

static inline __attribute__((always_inline)) void filter_columns_of(
    __global const real *image, __global const real *target, __global real *lines, int top,
    int height, int row, int stride, const int all_inside)
{
    FOR_EACH_BLOCK (block, row) {
        const int start = BLOCK_START(block, row);
        lane mean[ROWS], difference[ROWS], square[ROWS], product[ROWS];
        for (int r = 0; r < ROWS; r++)
            mean[r] = difference[r] = square[r] = product[r] = (lane)0;
#pragma unroll
        for (int t = 0; t < RING; t++) {
            ROW_INSIDE(nearest, weight_of_line, top + t - RADIUS, height);
            const int y = all_inside ? top + t - RADIUS : nearest;
            const real inside = all_inside ? (real)1 : weight_of_line;
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
        for (int r = 0; r < ROWS; r++) {
            __global real *line = lines + r * MAPS * stride + BORDER + start;
            STORE_GLOBAL(line, mean[r]);
            STORE_GLOBAL(line + stride, difference[r]);
            STORE_GLOBAL(line + 2 * stride, square[r]);
            STORE_GLOBAL(line + 3 * stride, product[r]);
        }
    }
}

static inline void filter_columns(
    __global const real *image, __global const real *target, __global real *lines, int top,
    int height, int row, int stride)
{
    if (ALL_INSIDE(top, height))
        filter_columns_of(image, target, lines, top, height, row, stride, 1);
    else
        filter_columns_of(image, target, lines, top, height, row, stride, 0);
}

/* Row y. Writes two sums over the row, of |x - y| and of 1 - SSIM, unless sums is null. */
static inline void dissimilarity(
    __global const real *image, __global const real *target, __global const real *lines,
    __global real *derivatives, __global real *sums, int row, int stride)
{
    const lane last = lanes_of_last_block(row);
    lane absolute = (lane)0, structural = (lane)0;
    FOR_EACH_BLOCK (block, row) {
        const int start = BLOCK_START(block, row);
        const int at = BORDER + start;
        const lane mean = filter_row(lines + at);
        const lane e = filter_row(lines + stride + at);
        const lane square = filter_row(lines + 2 * stride + at);
        const lane product = filter_row(lines + 3 * stride + at);

        lane by_mean, by_square, by_product;
        const lane lost = dissimilarity_of(
            mean, e, square, product, &by_mean, &by_square, &by_product);
        STORE_GLOBAL(derivatives + at, by_mean);
        STORE_GLOBAL(derivatives + stride + at, by_square);
        STORE_GLOBAL(derivatives + 2 * stride + at, by_product);

        const lane d = LOAD_GLOBAL(image + start) - LOAD_GLOBAL(target + start);
        const lane own = start == block ? (lane)1 : last;
        absolute += own * lane_abs(d);
        structural += own * lost;
    }
    if (sums) {
        sums[0] = sum_lanes(absolute);
        sums[1] = sum_lanes(structural);
    }
}

static inline __attribute__((always_inline)) void filter_derivatives_of(
    __global const real *ring, __global real *lines, int top, int height, int row, int stride,
    const int all_inside)
{
    FOR_EACH_BLOCK (block, row) {
        const int start = BORDER + BLOCK_START(block, row);
        lane sum0[ROWS], sum1[ROWS], sum2[ROWS];
        for (int r = 0; r < ROWS; r++)
            sum0[r] = sum1[r] = sum2[r] = (lane)0;
#pragma unroll
        for (int t = 0; t < RING; t++) {
            ROW_INSIDE(nearest, weight_of_line, top + t - RADIUS, height);
            const int y = all_inside ? top + t - RADIUS : nearest;
            const real inside = all_inside ? (real)1 : weight_of_line;
            __global const real *from = ring + (y % RING) * DERIVATIVES * stride + start;
            const lane value0 = inside * LOAD_GLOBAL(from);
            const lane value1 = inside * LOAD_GLOBAL(from + stride);
            const lane value2 = inside * LOAD_GLOBAL(from + 2 * stride);
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
        for (int r = 0; r < ROWS; r++) {
            __global real *line = lines + r * MAPS * stride + start;
            STORE_GLOBAL(line, sum0[r]);
            STORE_GLOBAL(line + stride, sum1[r]);
            STORE_GLOBAL(line + 2 * stride, sum2[r]);
        }
    }
}

static inline void filter_derivatives(
    __global const real *ring, __global real *lines, int top, int height, int row, int stride)
{
    if (ALL_INSIDE(top, height))
        filter_derivatives_of(ring, lines, top, height, row, stride, 1);
    else
        filter_derivatives_of(ring, lines, top, height, row, stride, 0);
}

/* d loss / d x of one row. */
static inline void gradient(
    __global const real *image, __global const real *target, __global const real *lines,
    __global real *result, int row, int stride, real l1_scale, real ssim_scale)
{
    FOR_EACH_BLOCK (block, row) {
        const int start = BLOCK_START(block, row);
        const int at = BORDER + start;
        const lane by_mean = filter_row(lines + at);
        const lane by_square = filter_row(lines + stride + at);
        const lane by_product = filter_row(lines + 2 * stride + at);
        const lane b = LOAD_GLOBAL(target + start);
        const lane d = LOAD_GLOBAL(image + start) - b;
        STORE_GLOBAL(
            result + start, slope_of(by_mean, by_square, by_product, d, b, l1_scale, ssim_scale));
    }
}

/* One work-item per band of band_rows rows. `sums` gets two sums a row; `result`
 * the gradient, if with_gradient; the scales are the weights of the two terms over the number of
 * reals in the image. `scratch` holds the lines and the ring of every band. */
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void photometric(
    __global const real *image, __global const real *target, __global real *scratch,
    __global real *sums, __global real *result, int height, int row, int stride, int band_rows,
    int with_gradient, real l1_scale, real ssim_scale)
{
    const int first = get_global_id(0) * band_rows;
    const int end = first + band_rows < height ? first + band_rows : height;
    const int around = with_gradient ? RADIUS : 0;
    const int begin = first > around ? first - around : 0;
    const int beyond = end + around < height ? end + around : height;
    __global real *lines = scratch
        + get_global_id(0) * (size_t)(ROWS * MAPS + RING * DERIVATIVES) * stride;
    __global real *ring = lines + ROWS * MAPS * stride;

    for (int top = begin; top < end + around; top += ROWS) {
        if (top < beyond) {
            filter_columns(image, target, lines, top, height, row, stride);
            for (int r = 0, y = top; r < ROWS && y < beyond; r++, y++) {
                dissimilarity(
                    image + (size_t)y * row, target + (size_t)y * row, lines + r * MAPS * stride,
                    ring + (y % RING) * DERIVATIVES * stride,
                    y >= first && y < end ? sums + 2 * y : 0, row, stride);
            }
        }
        const int behind = top - RADIUS;
        if (!with_gradient || behind + ROWS <= first)
            continue;
        filter_derivatives(ring, lines, behind, height, row, stride);
        for (int r = 0, y = behind; r < ROWS && y < end; r++, y++)
            if (y >= first)
                gradient(
                    image + (size_t)y * row, target + (size_t)y * row, lines + r * MAPS * stride,
                    result + (size_t)y * row, row, stride, l1_scale, ssim_scale);
    }
}
