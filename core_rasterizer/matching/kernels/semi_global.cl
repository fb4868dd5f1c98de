/* Semi-global aggregation of matching costs and selection of the best plane.
 * Twin: tests/core_rasterizer/matching_oracle.py.
 *
 * Volumes are [height][width][PLANES], PLANES a multiple of WIDTH, so that a vector is WIDTH
 * neighbouring planes of one pixel. A path's recursion (Hirschmueller 2008, eq. 13) is
 *   L(p, d) = C(p, d) + min(L(q, d), L(q, d +- 1) + P1, m + P2) - m,  m = min over k of L(q, k),
 * with q the pixel before p on the path. A path that enters the image starts from L(q, .) = 0 and
 * m = 0, which gives L = C.
 *
 * A work-item processes BAND neighbouring lines of one direction together, so each step touches BAND
 * neighbouring pixels and not a cache line per row. Lines of one direction share no pixel, and directions
 * run one after another, so sums need no atomics.
 */

#define WIDTH 16
/* Penalties are at most 7000: m + P2 stays below 15000, and eight paths together below 60000. */
#define NO_PATH 20000 /* more than m + P2, and P1 can still be added */
#define NO_SUM 65535

typedef ushort16 cells;
typedef uchar16 bytes;
typedef cells cells_anywhere __attribute__((aligned(2)));
#define LOAD_CELLS(pointer) (*(const cells_anywhere *)(pointer))
#if LANES == 1
#define WIDEN(x) convert_ushort16(x)
#else
#define WIDEN(x) __builtin_convertvector((x), cells)
#endif

static inline ushort least_cell(cells values)
{
    const ushort8 by8 = LANE_MIN(values.lo, values.hi);
    const ushort4 by4 = LANE_MIN(by8.lo, by8.hi);
    const ushort2 by2 = LANE_MIN(by4.lo, by4.hi);
    return LANE_MIN(by2.x, by2.y);
}

/* Lines l = 0 .. lines - 1 pass, at step t, the pixel origin + l * across + t * along. Where `slope`
 * is not 0 (diagonals) line l is at the column l + shift + slope * t, which may be outside. */
__kernel void aggregate_direction(
    __global const uchar *costs, __global const uchar *grey, __global const ushort *jump_penalties,
    __global ushort *sums, int width, int lines, int steps, int origin, int across, int along,
    int shift, int slope, int small_penalty)
{
    ushort paths[2][BAND][PLANES + 2 * WIDTH];
    ushort lowest[BAND];
    uchar level[BAND];
    for (int b = 0; b < BAND; b++) {
        for (int d = 0; d < PLANES + 2 * WIDTH; d++) {
            const bool beyond = d < WIDTH || d >= PLANES + WIDTH;
            paths[0][b][d] = paths[1][b][d] = beyond ? NO_PATH : 0;
        }
        lowest[b] = 0;
        level[b] = 0;
    }
    const int first = get_global_id(0) * BAND;
    const int count = LANE_MIN(BAND, lines - first);
    const cells p1 = (cells)((ushort)small_penalty);
    for (int t = 0; t < steps; t++) {
        for (int b = 0; b < count; b++) {
            const int column = first + b + shift + slope * t;
            if (slope != 0 && (column < 0 || column >= width))
                continue;
            const int pixel = origin + (first + b) * across + t * along;
            const uchar here = grey[pixel];
            const int step = here < level[b] ? level[b] - here : here - level[b];
            const cells floor_cost = (cells)lowest[b];
            const cells jump = floor_cost + (cells)jump_penalties[step];
            const ushort *before = paths[t & 1][b] + WIDTH;
            ushort *after = paths[(t + 1) & 1][b] + WIDTH;
            __global const bytes *cost = (__global const bytes *)(costs + (size_t)pixel * PLANES);
            __global cells *sum = (__global cells *)(sums + (size_t)pixel * PLANES);
            cells least = (cells)NO_PATH;
            for (int v = 0; v < PLANES / WIDTH; v++) {
                const cells below = LOAD_CELLS(before + v * WIDTH - 1) + p1;
                const cells above = LOAD_CELLS(before + v * WIDTH + 1) + p1;
                cells path = LOAD_CELLS(before + v * WIDTH);
                path = LANE_MIN(path, jump);
                path = LANE_MIN(path, below);
                path = LANE_MIN(path, above);
                path += WIDEN(cost[v]) - floor_cost;
                *(cells_anywhere *)(after + v * WIDTH) = path;
                least = LANE_MIN(least, path);
                sum[v] += path;
            }
            lowest[b] = least_cell(least);
            level[b] = here;
        }
    }
}

/* The lowest sum over planes [first, last); NO_SUM where there is none. */
static inline ushort least_sum(__global const ushort *sums, int first, int last)
{
    cells least = (cells)NO_SUM;
    int d = first;
    for (; d + WIDTH <= last; d += WIDTH) {
        const cells value = *(__global const cells_anywhere *)(sums + d);
        least = LANE_MIN(least, value);
    }
    ushort result = least_cell(least);
    for (; d < last; d++)
        result = LANE_MIN(result, sums[d]);
    return result;
}

__kernel void pick_plane(
    __global const ushort *sums, __global float *index, __global float *confidence, int planes)
{
    const size_t pixel = get_global_id(0);
    __global const ushort *sum = sums + pixel * PLANES;
    const ushort lowest = least_sum(sum, 0, planes);
    int best = 0;
    while (sum[best] != lowest)
        best++;
    float offset = 0;
    if (best > 0 && best < planes - 1) {
        /* Two lines of opposite slopes through three points; no offset if flat. */
        const int below = sum[best - 1] - lowest, above = sum[best + 1] - lowest;
        const int steeper = LANE_MAX(below, above);
        if (steeper > 0)
            offset = 0.5f * (below - above) / steeper;
    }
    const ushort rival_below = least_sum(sum, 0, best - 1);
    const ushort rival_above = least_sum(sum, best + 2, planes);
    const ushort rival = LANE_MIN(rival_below, rival_above);
    index[pixel] = best + offset;
    confidence[pixel] = rival == NO_SUM || rival == 0 ? 0.0f : (float)(rival - lowest) / rival;
}
