/* Rasterization on a GPU: one work-group per tile, one work-item per pixel; records are staged in local
 * memory. The pair buffer is the same as on a CPU. Sums over a tile's pixels have a fixed order. */

#define GROUP (TILE_WIDTH * TILE_HEIGHT)
#define BATCH 32 /* records staged at a time */
#define SEGMENTS 16 /* sums in parallel; a divisor of GROUP */

/* Copies the records of pairs [p, p + BATCH) into local memory. */
static inline void stage(
    __local real *staged, __global const real *records, __global const uint2 *pairs, uint p, uint end)
{
    for (uint k = get_local_id(0); k < BATCH * RECORD; k += GROUP)
        if (p + k / RECORD < end)
            staged[k] = records[(size_t)pairs[p + k / RECORD].x * RECORD + k % RECORD];
}

static inline real exponent_at(__local const real *g, real dx, real dy)
{
    return g[REC_A] * dx * dx + dy * (g[REC_B] * dx + g[REC_C] * dy);
}

/* Distances from the mean to a pixel's centre; the bracket is exact, the rest is the rounding error. */
static inline real distance_x(__local const real *g, int x)
{
    return (x + (real)0.5 - g[REC_X]) - g[REC_REST_X];
}

static inline real distance_y(__local const real *g, int y)
{
    return (y + (real)0.5 - g[REC_Y]) - g[REC_REST_Y];
}

static inline int in_box(__local const real *g, int x, int y)
{
    return x >= (int)g[REC_X0] && x < (int)g[REC_X1] && y >= (int)g[REC_Y0] && y < (int)g[REC_Y1];
}

/* True in every work-item if `open` is true in any. */
static inline int any_in_group(__local int *flag, int open)
{
    barrier(CLK_LOCAL_MEM_FENCE);
    if (get_local_id(0) == 0)
        *flag = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (open)
        *flag = 1;
    barrier(CLK_LOCAL_MEM_FENCE);
    return *flag;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void raster(
    __global const real *records, __global const uint2 *pairs, __global const uint *tile_starts,
    __global const ulong *counters, __global const wide *camera, __global real *rgb,
    __global real *depth, __global real *alpha, __global real *final_transmittance, int tiles_x,
    uint pair_capacity)
{
    __local real staged[BATCH * RECORD];
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
    for (uint p = tile_starts[tile]; p < end; p += BATCH) {
        if (!any_in_group(&flag, t > 0))
            break;
        stage(staged, records, pairs, p, end);
        barrier(CLK_LOCAL_MEM_FENCE);
        const uint batch = min((uint)BATCH, end - p);
        for (uint k = 0; k < batch; k++) {
            __local const real *g = staged + k * RECORD;
            if (t < 0 || !in_box(g, x, y))
                continue;
            const real exponent = exponent_at(g, distance_x(g, x), distance_y(g, y));
            const meeting m = meet(exponent, g[REC_OPACITY], t);
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

/* Sums PAIR_LAST + 1 values over the group into `out`: first SEGMENTS strided sums in parallel, then the
 * sum of these. This needs two barriers, a tree one per level. None is needed at the end: `parts` is written
 * again only after the first barrier of the next call, which its readers have to reach first. */
static inline void sum_group(
    __local real *scratch, __local real *parts, const real *values, __global real *out)
{
    const uint id = get_local_id(0);
    for (int k = 0; k <= PAIR_LAST; k++)
        scratch[k * GROUP + id] = values[k];
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint part = id; part < (PAIR_LAST + 1) * SEGMENTS; part += GROUP) {
        __local const real *all = scratch + part / SEGMENTS * GROUP + part % SEGMENTS;
        real sum = all[0];
        for (uint k = SEGMENTS; k < GROUP; k += SEGMENTS)
            sum += all[k];
        parts[part] = sum;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint k = id; k <= PAIR_LAST; k += GROUP) {
        real sum = parts[k * SEGMENTS];
        for (uint part = 1; part < SEGMENTS; part++)
            sum += parts[k * SEGMENTS + part];
        out[k] = sum;
    }
}

/* See raster_cpu.cl for the formula. */
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void raster_backward(
    __global const real *records, __global const uint2 *pairs, __global const uint *tile_starts,
    __global const wide *camera, __global const real *rgb, __global const real *depth,
    __global const real *final_transmittance, __global const real *d_rgb,
    __global const real *d_depth, __global const real *d_alpha, __global real *pair_sums,
    int tiles_x, int with_depth)
{
    __local real staged[BATCH * RECORD];
    __local real scratch[(PAIR_LAST + 1) * GROUP], parts[(PAIR_LAST + 1) * SEGMENTS];
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
    for (uint p = tile_starts[tile]; p < end; p += BATCH) {
        const uint batch = min((uint)BATCH, end - p);
        if (!any_in_group(&flag, t > 0)) {
            const size_t last = (size_t)end * (PAIR_LAST + 1);
            for (size_t k = (size_t)p * (PAIR_LAST + 1) + local_id; k < last; k += GROUP)
                pair_sums[(size_t)pairs[k / (PAIR_LAST + 1)].y * PAIR + k % (PAIR_LAST + 1)] = 0;
            break;
        }
        stage(staged, records, pairs, p, end);
        barrier(CLK_LOCAL_MEM_FENCE);
        for (uint k = 0; k < batch; k++) {
            __local const real *g = staged + k * RECORD;
            real sums[PAIR_LAST + 1];
            for (int s = 0; s <= PAIR_LAST; s++)
                sums[s] = 0;
            if (t > 0 && in_box(g, x, y)) {
                const real dx = distance_x(g, x), dy = distance_y(g, y);
                const meeting m = meet(exponent_at(g, dx, dy), g[REC_OPACITY], t);
                t = keep_transmittance(m, t);
                const real value
                    = g[REC_RED] * red + g[REC_GREEN] * green + g[REC_BLUE] * blue + g[REC_Z] * z;
                rest -= m.weight * value;
                if (m.weight > 0 && m.raw <= ALPHA_MAX) {
                    const real d_p = (m.next * value - rest) / (1 - m.alpha) * m.alpha;
                    sums[PAIR_P] = d_p;
                    sums[PAIR_PX] = d_p * dx;
                    sums[PAIR_PY] = d_p * dy;
                    sums[PAIR_PXX] = d_p * dx * dx;
                    sums[PAIR_PXY] = d_p * dx * dy;
                    sums[PAIR_PYY] = d_p * dy * dy;
#ifdef ABSOLUTE
                    const real slope_x = 2 * g[REC_A] * dx + g[REC_B] * dy;
                    const real slope_y = g[REC_B] * dx + 2 * g[REC_C] * dy;
                    sums[PAIR_ABSOLUTE_X] = fabs(d_p * slope_x);
                    sums[PAIR_ABSOLUTE_Y] = fabs(d_p * slope_y);
#endif
                }
                sums[PAIR_RED] = m.weight * red;
                sums[PAIR_GREEN] = m.weight * green;
                sums[PAIR_BLUE] = m.weight * blue;
                sums[PAIR_Z] = m.weight * z;
                sums[PAIR_TOUCHED] = m.weight;
            }
            sum_group(scratch, parts, sums, pair_sums + (size_t)pairs[p + k].y * PAIR);
        }
    }
}
