/* Lists, for each tile, the Gaussians that can touch it, nearest first.
 *
 * A counting pass and a filling pass walk the Gaussians in depth order, chunk by chunk, so the lists
 * need no sort of their own. Each (tile, Gaussian) pair also gets a slot; the slots of one Gaussian
 * are neighbours, so that its gradient is a sum over contiguous memory in a fixed order. */

typedef struct {
    int x0, x1, y0, y1; /* tiles, half open */
} tile_box;

static inline tile_box tiles_of(__global const real *record)
{
    tile_box box;
    box.x0 = (int)record[REC_X0] / TILE_WIDTH;
    box.x1 = ((int)record[REC_X1] + TILE_WIDTH - 1) / TILE_WIDTH;
    box.y0 = (int)record[REC_Y0] / TILE_HEIGHT;
    box.y1 = ((int)record[REC_Y1] + TILE_HEIGHT - 1) / TILE_HEIGHT;
    return box;
}

/* Does the ellipse where alpha >= 1/255 reach a pixel centre of the tile? The exponent is a concave
 * quadratic with its maximum at the mean: if the mean is outside, the maximum over the tile lies on an
 * edge that faces it. */
static inline int reaches(__global const real *record, int tile_x, int tile_y)
{
    const real low_x = tile_x * TILE_WIDTH + (real)0.5 - record[REC_X];
    const real low_y = tile_y * TILE_HEIGHT + (real)0.5 - record[REC_Y];
    const real high_x = low_x + (TILE_WIDTH - 1), high_y = low_y + (TILE_HEIGHT - 1);
    const int inside_x = low_x <= 0 && high_x >= 0, inside_y = low_y <= 0 && high_y >= 0;
    if (inside_x && inside_y)
        return 1;
    const real a = record[REC_A], b = record[REC_B], c = record[REC_C];
    real best = -REAL_LARGEST;
    if (!inside_x) {
        const real x = low_x > 0 ? low_x : high_x;
        real y = (real)-0.5 * b * x / c;
        y = y < low_y ? low_y : (y > high_y ? high_y : y);
        best = a * x * x + (b * x + c * y) * y;
    }
    if (!inside_y) {
        const real y = low_y > 0 ? low_y : high_y;
        real x = (real)-0.5 * b * y / a;
        x = x < low_x ? low_x : (x > high_x ? high_x : x);
        const real value = a * x * x + (b * x + c * y) * y;
        best = best > value ? best : value;
    }
    /* A hair more than exact, since the per-pixel test decides; written so that an undefined value
     * (a needle's a or c rounded to 0) keeps the pair. */
    return !(best < record[REC_FLOOR] * (real)1.0001 - (real)1e-3);
}

__kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void count_tiles(
    __global const real *records, __global const uint *order, __global uint *counts,
    __global uint *chunk_pairs, __global const ulong *counters, uint tiles, int tiles_x)
{
    const size_t chunks = get_global_size(0), chunk = get_global_id(0);
    __global uint *mine = counts + chunk * tiles;
    for (uint tile = 0; tile < tiles; tile++)
        mine[tile] = 0;
    const size_t visible = counters[COUNT_VISIBLE], end = visible * (chunk + 1) / chunks;
    ulong pairs = 0;
    for (size_t r = visible * chunk / chunks; r < end; r++) {
        __global const real *record = records + (size_t)order[r] * RECORD;
        const tile_box box = tiles_of(record);
        for (int y = box.y0; y < box.y1; y++)
            for (int x = box.x0; x < box.x1; x++)
                if (reaches(record, x, y)) {
                    mine[y * tiles_x + x]++;
                    pairs++;
                }
    }
    /* More than 2^32 pairs in one chunk can never fit; saturating keeps the refusal honest. */
    chunk_pairs[chunk] = pairs > 0xFFFFFFFFul ? 0xFFFFFFFFu : (uint)pairs;
}

/* One entry of a tile's list: which Gaussian, and where its partial gradient goes. */
__kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void fill_tiles(
    __global const real *records, __global const uint *order, __global uint *counts,
    __global const uint *tile_starts, __global const uint *chunk_starts, __global uint2 *pairs,
    __global uint *slot_start, __global uint *slot_count, __global const ulong *counters,
    uint tiles, int tiles_x, uint pair_capacity)
{
    if (counters[COUNT_PAIRS] > pair_capacity)
        return;
    const size_t chunks = get_global_size(0), chunk = get_global_id(0);
    __global uint *mine = counts + chunk * tiles;
    for (uint tile = 0; tile < tiles; tile++)
        mine[tile] += tile_starts[tile];
    const size_t visible = counters[COUNT_VISIBLE], end = visible * (chunk + 1) / chunks;
    uint slot = chunk_starts[chunk];
    for (size_t r = visible * chunk / chunks; r < end; r++) {
        const uint gaussian = order[r];
        __global const real *record = records + (size_t)gaussian * RECORD;
        const tile_box box = tiles_of(record);
        slot_start[gaussian] = slot;
        for (int y = box.y0; y < box.y1; y++)
            for (int x = box.x0; x < box.x1; x++)
                if (reaches(record, x, y))
                    pairs[mine[y * tiles_x + x]++] = (uint2)(gaussian, slot++);
        slot_count[gaussian] = slot - slot_start[gaussian];
    }
}
