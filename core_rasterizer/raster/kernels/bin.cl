/* Lists, for each tile, the Gaussians that can touch it, nearest first.
 *
 * A counting pass and a filling pass walk the Gaussians in depth order, chunk by chunk, so the lists
 * need no sort of their own. Each (tile, Gaussian) pair also gets a slot; the slots of one Gaussian
 * are neighbours, so that its gradient is a sum over contiguous memory in a fixed order. */

#define LOT (1u << 20)
#define ORDER_AHEAD 16 /* Gaussians: depth order is random order in memory, so a CPU is told in advance */

__kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void count_tiles(
    __global const real *records, __global const uint4 *covers, __global const uint *order,
    __global uint *counts, __global uint *chunk_pairs, __global const ulong *counters, uint tiles,
    int tiles_x, uint pair_limit)
{
    const size_t chunks = get_global_size(0), chunk = get_global_id(0);
    __global uint *mine = counts + chunk * tiles;
    for (uint tile = 0; tile < tiles; tile++)
        mine[tile] = 0;
    const size_t visible = counters[COUNT_VISIBLE], end = visible * (chunk + 1) / chunks;
    /* Chunks add up the lots that they have counted: beyond the limit the render will be refused, and
     * all can stop. The total is then that of a part, but beyond the limit too. */
    volatile __global uint *lots = chunk_pairs + chunks;
    ulong pairs = 0, reported = 0;
    for (size_t r = visible * chunk / chunks; r < end && *lots <= pair_limit / LOT; r++) {
        if (r + ORDER_AHEAD < end)
            PREFETCH(covers + order[r + ORDER_AHEAD]);
        const uint4 cover = covers[order[r]];
        FOR_EACH_TILE(cover, records + (size_t)order[r] * RECORD, {
            mine[tile]++;
            pairs++;
        })
        for (; pairs - reported >= LOT; reported += LOT)
            atomic_inc(lots);
    }
    chunk_pairs[chunk] = (uint)pairs; /* hardly more than the limit, which is well below 2^32 */
}

/* One entry of a tile's list: which Gaussian, and where its partial gradient goes. */
__kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void fill_tiles(
    __global const real *records, __global const uint4 *covers, __global const uint *order,
    __global uint *counts, __global const uint *tile_starts,
    __global uint *chunk_starts, __global uint2 *pairs, __global uint *slot_start,
    __global uint *slot_count, __global const ulong *counters, uint tiles, int tiles_x,
    uint pair_capacity)
{
    const size_t chunks = get_global_size(0), chunk = get_global_id(0);
    if (chunk == 0)
        chunk_starts[chunks] = 0; /* the lots of the next count */
    if (counters[COUNT_PAIRS] > pair_capacity)
        return;
    __global uint *mine = counts + chunk * tiles;
    for (uint tile = 0; tile < tiles; tile++)
        mine[tile] += tile_starts[tile];
    const size_t visible = counters[COUNT_VISIBLE], end = visible * (chunk + 1) / chunks;
    uint slot = chunk_starts[chunk];
    for (size_t r = visible * chunk / chunks; r < end; r++) {
        const uint gaussian = order[r];
        if (r + ORDER_AHEAD < end) {
            PREFETCH(covers + order[r + ORDER_AHEAD]);
            PREFETCH_TO_WRITE(slot_start + order[r + ORDER_AHEAD]);
            PREFETCH_TO_WRITE(slot_count + order[r + ORDER_AHEAD]);
        }
        const uint4 cover = covers[gaussian];
        slot_start[gaussian] = slot;
        FOR_EACH_TILE(cover, records + (size_t)gaussian * RECORD,
            { pairs[mine[tile]++] = (uint2)(gaussian, slot++); })
        slot_count[gaussian] = slot - slot_start[gaussian];
    }
}
