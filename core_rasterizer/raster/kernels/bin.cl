/* Lists, for each tile, the Gaussians that can touch it, nearest first.
 *
 * A counting pass and a filling pass process the Gaussians in depth order, chunk by chunk, so the lists need
 * not be sorted. Each (tile, Gaussian) pair also gets a slot; the slots of one Gaussian are contiguous, so
 * that its gradient is a sum over contiguous memory in a fixed order. */

#define PAIRS_PER_REPORT (1u << 20) /* of a chunk to the shared count */
#define ORDER_AHEAD 16 /* Gaussians to prefetch ahead: depth order is random order in memory */

/* Counts pairs by tile for Gaussians [begin, end) of the depth order; returns how many there are. Chunks
 * report their pairs in `reports`; beyond the limit the render fails, so all stop early. The total is then
 * incomplete, but above the limit too. */
static inline uint count_tiles_in(
    __global const real *records, __global const uint4 *covers, __global const uint *order,
    __global uint *mine, volatile __global uint *reports, size_t begin, size_t end, uint tiles,
    int tiles_x, uint pair_limit)
{
    for (uint tile = 0; tile < tiles; tile++)
        mine[tile] = 0;
    ulong pairs = 0, reported = 0;
    for (size_t r = begin; r < end && *reports <= pair_limit / PAIRS_PER_REPORT; r++) {
        if (r + ORDER_AHEAD < end)
            PREFETCH(covers + order[r + ORDER_AHEAD]);
        const uint4 cover = covers[order[r]];
        FOR_EACH_TILE(cover, records + (size_t)order[r] * REC_SIZE, {
            mine[tile]++;
            pairs++;
        })
        for (; pairs - reported >= PAIRS_PER_REPORT; reported += PAIRS_PER_REPORT)
            atomic_inc(reports);
    }
    return (uint)pairs; /* little more than the limit, which is well below 2^32 */
}

/* Write entries of the tiles' lists: Gaussian, and slot of its partial gradient. `mine` holds the index of
 * the chunk's first entry of each tile. */
static inline void fill_tiles_in(
    __global const real *records, __global const uint4 *covers, __global const uint *order,
    __global uint *mine, __global uint2 *pairs, __global uint *slot_start,
    __global uint *slot_count, size_t begin, size_t end, uint slot, int tiles_x)
{
    for (size_t r = begin; r < end; r++) {
        const uint gaussian = order[r];
        if (r + ORDER_AHEAD < end) {
            PREFETCH(covers + order[r + ORDER_AHEAD]);
            PREFETCH_TO_WRITE(slot_start + order[r + ORDER_AHEAD]);
            PREFETCH_TO_WRITE(slot_count + order[r + ORDER_AHEAD]);
        }
        const uint4 cover = covers[gaussian];
        slot_start[gaussian] = slot;
        FOR_EACH_TILE(cover, records + (size_t)gaussian * REC_SIZE, {
            pairs[mine[tile]++] = (uint2)(gaussian, slot++);
        })
        slot_count[gaussian] = slot - slot_start[gaussian];
    }
}

__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void count_tiles(
    __global const real *records, __global const uint4 *covers, __global const uint *order,
    __global uint *counts, __global uint *chunk_pairs, __global const ulong *counters, uint tiles,
    int tiles_x, uint pair_limit)
{
    const size_t chunks = get_global_size(0), chunk = get_global_id(0);
    const size_t visible = counters[COUNT_VISIBLE];
    chunk_pairs[chunk] = count_tiles_in(
        records, covers, order, counts + chunk * tiles, chunk_pairs + chunks,
        visible * chunk / chunks, visible * (chunk + 1) / chunks, tiles, tiles_x, pair_limit);
}

__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void fill_tiles(
    __global const real *records, __global const uint4 *covers, __global const uint *order,
    __global uint *counts, __global const uint *tile_starts, __global uint *chunk_starts,
    __global uint2 *pairs, __global uint *slot_start, __global uint *slot_count,
    __global const ulong *counters, uint tiles, int tiles_x, uint pair_capacity)
{
    const size_t chunks = get_global_size(0), chunk = get_global_id(0);
    if (chunk == 0)
        chunk_starts[chunks] = 0; /* the reports of the next count */
    if (counters[COUNT_PAIRS] > pair_capacity)
        return;
    __global uint *mine = counts + chunk * tiles;
    for (uint tile = 0; tile < tiles; tile++)
        mine[tile] += tile_starts[tile];
    const size_t visible = counters[COUNT_VISIBLE];
    fill_tiles_in(
        records, covers, order, mine, pairs, slot_start, slot_count, visible * chunk / chunks,
        visible * (chunk + 1) / chunks, chunk_starts[chunk], tiles_x);
}
