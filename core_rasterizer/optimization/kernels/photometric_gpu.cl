/* L1 + D-SSIM on a GPU: a work-group takes a tile of TILE x TILE pixels, with what its windows reach in local
 * memory, one channel after another. `dissimilarity` writes the derivatives of SSIM, `gradient` filters them
 * again: neighbouring tiles share them through global memory instead of computing them twice. */

#define GROUP (TILE * TILE)
#define AROUND (TILE + 2 * RADIUS)
#define AREA (AROUND * AROUND)
#define LINES (TILE * AROUND)

/* A tile's pixels of this work-item. */
typedef struct {
    int x, y, width, height, inside;
} tile_pixel;

static inline tile_pixel pixel_of_item(int width, int height)
{
    const int across = (width + TILE - 1) / TILE, tile = get_group_id(0), id = get_local_id(0);
    tile_pixel p;
    p.width = width;
    p.height = height;
    p.x = tile % across * TILE + id % TILE;
    p.y = tile / across * TILE + id / TILE;
    p.inside = p.x < width && p.y < height;
    return p;
}

/* Index of the k-th pixel around the tile, or -1 outside the image. */
static inline long around_tile(tile_pixel p, int k)
{
    const int id = get_local_id(0);
    const int x = p.x - id % TILE - RADIUS + k % AROUND, y = p.y - id / TILE - RADIUS + k / AROUND;
    return x >= 0 && y >= 0 && x < p.width && y < p.height ? (long)y * p.width + x : -1;
}

/* The windows of a tile's lines at this work-item's pixel. */
static inline real across(__local const real *lines)
{
    const int id = get_local_id(0);
    __local const real *first = lines + id / TILE * AROUND + id % TILE;
    real sum = 0;
    for (int k = 0; k < TAPS; k++)
        sum += window[k] * first[k];
    return sum;
}

/* The sums of two values over the group, in a fixed order. */
static inline void sum_group(__local real *memory, real first, real second, __global real *sums)
{
    const int id = get_local_id(0);
    memory[id] = first;
    memory[GROUP + id] = second;
    barrier(CLK_LOCAL_MEM_FENCE);
    real sum = 0;
    if (id < 2 * TILE)
        for (int k = 0; k < TILE; k++)
            sum += memory[id * TILE + k];
    barrier(CLK_LOCAL_MEM_FENCE);
    if (id < 2 * TILE)
        memory[id] = sum;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (id < 2) {
        sum = 0;
        for (int k = 0; k < TILE; k++)
            sum += memory[id * TILE + k];
        sums[id] = sum;
    }
}

/* Two sums per tile, of |x - y| and of 1 - SSIM; `derivatives[channel][map][pixel]`, if with_gradient. */
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void dissimilarity(
    __global const real *image, __global const real *target, __global real *derivatives,
    __global real *sums, int width, int height, int with_gradient)
{
    __local real x[AREA], difference[AREA], lines[MAPS * LINES];
    const int id = get_local_id(0);
    const tile_pixel p = pixel_of_item(width, height);
    const size_t pixels = (size_t)width * height, pixel = (size_t)p.y * width + p.x;
    real absolute = 0, structural = 0;
    for (int channel = 0; channel < CHANNELS; channel++) {
        for (int k = id; k < AREA; k += GROUP) {
            const long at = around_tile(p, k);
            x[k] = at < 0 ? 0 : image[CHANNELS * at + channel];
            difference[k] = at < 0 ? 0 : x[k] - target[CHANNELS * at + channel];
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int k = id; k < LINES; k += GROUP) {
            real mean = 0, e = 0, square = 0, product = 0;
            for (int t = 0; t < TAPS; t++) {
                const real a = x[k + t * AROUND], d = difference[k + t * AROUND];
                mean += window[t] * a;
                e += window[t] * d;
                square += window[t] * (d * d);
                product += window[t] * (a * (a - d));
            }
            lines[k] = mean;
            lines[LINES + k] = e;
            lines[2 * LINES + k] = square;
            lines[3 * LINES + k] = product;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        real by_mean, by_square, by_product;
        const real lost = dissimilarity_of(
            across(lines), across(lines + LINES), across(lines + 2 * LINES),
            across(lines + 3 * LINES), &by_mean, &by_square, &by_product);
        const real d = difference[(id / TILE + RADIUS) * AROUND + id % TILE + RADIUS];
        if (p.inside) {
            absolute += fabs(d);
            structural += lost;
        }
        if (p.inside && with_gradient) {
            __global real *out = derivatives + channel * DERIVATIVES * pixels + pixel;
            out[0] = by_mean;
            out[pixels] = by_square;
            out[2 * pixels] = by_product;
        }
        barrier(CLK_LOCAL_MEM_FENCE); /* before the next channel overwrites what is still read */
    }
    sum_group(lines, absolute, structural, sums + 2 * get_group_id(0));
}

/* d loss / d x. The scales are the weights of the two terms over the number of reals in the image. */
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void gradient(
    __global const real *image, __global const real *target, __global const real *derivatives,
    __global real *result, int width, int height, real l1_scale, real ssim_scale)
{
    __local real maps[DERIVATIVES * AREA], lines[DERIVATIVES * LINES];
    const int id = get_local_id(0);
    const tile_pixel p = pixel_of_item(width, height);
    const size_t pixels = (size_t)width * height, pixel = (size_t)p.y * width + p.x;
    for (int channel = 0; channel < CHANNELS; channel++) {
        __global const real *from = derivatives + channel * DERIVATIVES * pixels;
        for (int k = id; k < AREA; k += GROUP) {
            const long at = around_tile(p, k);
            for (int map = 0; map < DERIVATIVES; map++)
                maps[map * AREA + k] = at < 0 ? 0 : from[map * pixels + at];
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int k = id; k < DERIVATIVES * LINES; k += GROUP) {
            __local const real *map = maps + k / LINES * AREA + k % LINES;
            real sum = 0;
            for (int t = 0; t < TAPS; t++)
                sum += window[t] * map[t * AROUND];
            lines[k] = sum;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        if (p.inside) {
            const size_t at = CHANNELS * pixel + channel;
            result[at] = slope_of(
                across(lines), across(lines + LINES), across(lines + 2 * LINES),
                image[at] - target[at], target[at], l1_scale, ssim_scale);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}
