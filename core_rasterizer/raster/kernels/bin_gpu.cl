/* Lists, for each tile, the Gaussians that can touch it, nearest first, on a GPU: lists and slots as in
 * bin.cl, with one work-group per chunk of the depth order and one work-item per Gaussian. */

#define LOT (1u << 14)

__kernel __attribute__((reqd_work_group_size(CHUNK_GROUP, 1, 1)))
void count_tiles(
    __global const real *records, __global const uint4 *covers, __global const uint *order,
    __global uint *counts, __global uint *chunk_pairs, __global const ulong *counters, uint tiles,
    int tiles_x, uint pair_limit)
{
    __local ulong found[CHUNK_GROUP];
    const uint id = get_local_id(0);
    const size_t chunks = get_num_groups(0), chunk = get_group_id(0);
    __global uint *mine = counts + chunk * tiles;
    for (uint tile = id; tile < tiles; tile += CHUNK_GROUP)
        mine[tile] = 0;
    barrier(CLK_GLOBAL_MEM_FENCE);
    const size_t visible = counters[COUNT_VISIBLE];
    const size_t begin = visible * chunk / chunks, end = visible * (chunk + 1) / chunks;
    /* All sum lots of pairs; beyond the limit the render fails, so all stop early. */
    volatile __global uint *lots = chunk_pairs + chunks;
    ulong pairs = 0;
    for (size_t r = begin + id; r < end && *lots <= pair_limit / LOT; r += CHUNK_GROUP) {
        const uint4 cover = covers[order[r]];
        FOR_EACH_TILE(cover, records + (size_t)order[r] * RECORD, {
            atomic_inc(mine + tile);
            if (++pairs % LOT == 0)
                atomic_inc(lots);
        })
    }
    found[id] = pairs;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (id > 0)
        return;
    for (uint other = 1; other < CHUNK_GROUP; other++)
        pairs += found[other];
    /* Beyond the limit the exact number does not matter, but it must not overflow. */
    chunk_pairs[chunk] = pairs > pair_limit ? pair_limit + 1 : (uint)pairs;
}

/* Whether FOR_EACH_TILE would visit a tile. */
static inline int covers_tile(uint4 cover, __global const real *record, int tile_x, int tile_y)
{
    const int x = tile_x - (int)(cover.x & 0xFFFF), y = tile_y - (int)(cover.x >> 16);
    const int width = cover.y & 0xFFFF, height = cover.y >> 16;
    if (x < 0 || y < 0 || x >= width || y >= height)
        return 0;
    if (width * height > BOX_BITS)
        return reaches(record, -log2((real)ALPHA_CUT_INVERSE * record[REC_OPACITY]), tile_x, tile_y);
    return (int)((cover.z | (ulong)cover.w << 32) >> (y * width + x) & 1);
}

__kernel __attribute__((reqd_work_group_size(CHUNK_GROUP, 1, 1)))
void fill_tiles(
    __global const real *records, __global const uint4 *covers, __global const uint *order,
    __global uint *counts, __global const uint *tile_starts,
    __global uint *chunk_starts, __global uint2 *pairs, __global uint *slot_start,
    __global uint *slot_count, __global const ulong *counters, uint tiles, int tiles_x,
    uint pair_capacity)
{
    __local uint gaussians[CHUNK_GROUP], sizes[CHUNK_GROUP];
    __local uint4 batch_covers[CHUNK_GROUP];
    const uint id = get_local_id(0);
    const size_t chunks = get_num_groups(0), chunk = get_group_id(0);
    if (chunk == 0 && id == 0)
        chunk_starts[chunks] = 0; /* the lots of the next count */
    if (counters[COUNT_PAIRS] > pair_capacity)
        return;
    /* Index of the chunk's next entry of each tile. */
    __global uint *mine = counts + chunk * tiles;
    for (uint tile = id; tile < tiles; tile += CHUNK_GROUP)
        mine[tile] += tile_starts[tile];
    const size_t visible = counters[COUNT_VISIBLE];
    const size_t begin = visible * chunk / chunks, end = visible * (chunk + 1) / chunks;
    uint slot = chunk_starts[chunk];
    for (size_t batch = begin; batch < end; batch += CHUNK_GROUP) {
        const uint members = (uint)min((size_t)CHUNK_GROUP, end - batch);
        const uint gaussian = order[batch + min(id, members - 1)];
        __global const real *record = records + (size_t)gaussian * RECORD;
        const uint4 cover = covers[gaussian];
        uint size = 0;
        if (id < members)
            FOR_EACH_TILE(cover, record, { size += tile >= 0; })
        gaussians[id] = gaussian;
        batch_covers[id] = cover;
        sizes[id] = size;
        barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
        if (id < members) {
            uint own = slot;
            for (uint other = 0; other < id; other++)
                own += sizes[other];
            slot_start[gaussian] = own;
            slot_count[gaussian] = size;
            FOR_EACH_TILE(cover, record, {
                uint to = mine[tile];
                for (uint other = 0; other < id; other++)
                    to += covers_tile(
                        batch_covers[other], records + (size_t)gaussians[other] * RECORD, x, y);
                pairs[to] = (uint2)(gaussian, own++);
            })
        }
        for (uint other = 0; other < members; other++)
            slot += sizes[other];
        barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
        if (id < members)
            FOR_EACH_TILE(cover, record, { atomic_inc(mine + tile); })
    }
}
