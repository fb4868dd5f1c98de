/* Lists, for each tile, the Gaussians that can touch it, nearest first.
 *
 * A counting pass and a filling pass walk the Gaussians in depth order, chunk by chunk, so the lists
 * need no sort of their own. Each (tile, Gaussian) pair also gets a slot; the slots of one Gaussian
 * are neighbours, so that its gradient is a sum over contiguous memory in a fixed order. */

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
    /* Set by a chunk that alone has too many pairs: the render is refused, and all stop counting. */
    volatile __global uint *refused = chunk_pairs + chunks;
    ulong pairs = 0;
    for (size_t r = visible * chunk / chunks; r < end && *refused <= pair_limit; r++) {
        const uint4 cover = covers[order[r]];
        FOR_EACH_TILE(cover, records + (size_t)order[r] * RECORD, {
            mine[tile]++;
            pairs++;
        })
        if (pairs > pair_limit)
            *refused = 0xFFFFFFFFu;
    }
    chunk_pairs[chunk] = (uint)pairs; /* at most pair_limit and one Gaussian's tiles: below 2^32 */
}

/* One entry of a tile's list: which Gaussian, and where its partial gradient goes. */
__kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void fill_tiles(
    __global const real *records, __global const uint4 *covers, __global const uint *order,
    __global uint *counts, __global const uint *tile_starts,
    __global const uint *chunk_starts, __global uint2 *pairs, __global uint *slot_start,
    __global uint *slot_count, __global const ulong *counters, uint tiles, int tiles_x,
    uint pair_capacity)
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
        const uint4 cover = covers[gaussian];
        slot_start[gaussian] = slot;
        FOR_EACH_TILE(cover, records + (size_t)gaussian * RECORD,
            { pairs[mine[tile]++] = (uint2)(gaussian, slot++); })
        slot_count[gaussian] = slot - slot_start[gaussian];
    }
}
