/* Lists, for each tile, the Gaussians that can touch it, nearest first, on a GPU: the lists and slots of
 * bin.cl. All visible Gaussians, in depth order, offer their tiles as candidates: those in the mask of a
 * small box, every tile of a box of more than 64. Chunks share the candidates equally, so that no work-item
 * waits for a large Gaussian. A pair's slot is its rank among the candidates that are reached; sorting the
 * pairs by tile, stably, gives the lists. */

#define PAIRS_PER_REPORT (1u << 14) /* of a work-item to the shared count */

static inline int is_large(uint4 cover)
{
    return (cover.y & 0xFFFF) * (cover.y >> 16) > BOX_BITS;
}

static inline uint candidates_of(uint4 cover)
{
    if (is_large(cover))
        return (cover.y & 0xFFFF) * (cover.y >> 16);
    return popcount(cover.z) + popcount(cover.w);
}

/* Position of the n-th bit that is set, from 0. */
static inline uint position_of_bit(ulong mask, uint n)
{
    uint position = 0;
    for (uint half_width = 32; half_width > 0; half_width /= 2) {
        const uint low = (uint)(mask & ((1ul << half_width) - 1)), found = popcount(low);
        if (n >= found) {
            n -= found;
            position += half_width;
            mask >>= half_width;
        }
    }
    return position;
}

/* offsets[r]: the candidates before the r-th visible Gaussian in its run of 2^run_bits. */
__kernel __attribute__((reqd_work_group_size(LIST_GROUP, 1, 1))) void scan_candidates(
    __global const uint4 *covers, __global const uint *order, __global ulong *offsets,
    __global ulong *totals, __global uint *chunk_pairs, __global ulong *counters, uint pair_chunks,
    uint run_bits)
{
    __local scan_memory memory;
    BEGIN_STEPS;
    const uint id = get_local_id(0);
    const size_t visible = counters[COUNT_VISIBLE];
    const size_t begin = (size_t)get_group_id(0) << run_bits;
    const size_t end = min(visible, begin + ((size_t)1 << run_bits));
    ulong carry = 0, total;
    for (size_t batch = begin; batch < end; batch += LIST_GROUP) {
        const size_t r = batch + id;
        const ulong before = scan_group(
            &memory, r < end ? candidates_of(covers[order[r]]) : 0, &total);
        if (r < end)
            offsets[r] = carry + before;
        carry += total;
        STEPS(SCAN_STEPS);
    }
    if (id == 0)
        totals[get_group_id(0)] = carry;
    if (id == 0 && get_group_id(0) == 0)
        chunk_pairs[pair_chunks] = 0; /* the reports of `count_pairs` */
    END_STEPS(counters);
}

/* The first candidate of the r-th Gaussian: offsets within runs, and starts of runs. */
static inline ulong first_candidate(
    __local const ulong *starts, __global const ulong *offsets, uint r, uint run_bits)
{
    return starts[r >> run_bits] + offsets[r];
}

/* A candidate's Gaussian: its rank in depth order, and the candidates [first, end) that it offers. */
typedef struct {
    uint rank;
    ulong first, end;
} owner;

/* Moves on to the owner of a candidate that is not before the current owner's; returns the steps taken. */
static inline uint find_owner(
    __local const ulong *starts, __global const ulong *offsets, uint run_bits, uint visible,
    ulong candidates, ulong candidate, owner *found)
{
    if (candidate < found->end)
        return 1;
    uint low = found->end > 0 ? found->rank + 1 : 0, beyond = visible, steps = 2;
    for (; beyond - low > 1; steps++) {
        const uint middle = low + (beyond - low) / 2;
        if (first_candidate(starts, offsets, middle, run_bits) <= candidate)
            low = middle;
        else
            beyond = middle;
    }
    found->rank = low;
    found->first = first_candidate(starts, offsets, low, run_bits);
    found->end = low + 1 < visible ? first_candidate(starts, offsets, low + 1, run_bits)
                                   : candidates;
    return steps;
}

/* Tile of the n-th candidate of a Gaussian, or -1 if the Gaussian does not reach it. */
static inline int tile_of_candidate(uint4 cover, __global const real *record, uint n, int tiles_x)
{
    const uint width = cover.y & 0xFFFF;
    const int large = is_large(cover);
    const uint place = large ? n : position_of_bit(cover.z | (ulong)cover.w << 32, n);
    const int x = (cover.x & 0xFFFF) + place % width, y = (cover.x >> 16) + place / width;
    if (large && !reaches(record, -log2((real)ALPHA_CUT_INVERSE * record[REC_OPACITY]), x, y))
        return -1;
    return y * tiles_x + x;
}

/* chunk_pairs[chunk]: the pairs among the chunk's share of the candidates. All report their pairs to the
 * element after the last chunk; beyond the limit the render fails, so all stop early. */
__kernel __attribute__((reqd_work_group_size(LIST_GROUP, 1, 1))) void count_pairs(
    __global const real *records, __global const uint4 *covers, __global const uint *order,
    __global const ulong *offsets, __global const ulong *totals, __global uint *chunk_pairs,
    __global ulong *counters, uint runs, uint run_bits, uint pair_limit)
{
    __local scan_memory memory;
    __local ulong starts[LIST_GROUP];
    BEGIN_STEPS;
    const size_t chunks = get_num_groups(0), chunk = get_group_id(0);
    const uint visible = (uint)counters[COUNT_VISIBLE];
    const ulong candidates = starts_of_runs(&memory, starts, totals, runs);
    const ulong end = candidates * (chunk + 1) / chunks;
    volatile __global uint *reports = chunk_pairs + chunks;
    owner found = {0, 0, 0};
    ulong pairs = 0, total;
    for (ulong candidate = candidates * chunk / chunks + get_local_id(0);
         candidate < end && *reports <= pair_limit / PAIRS_PER_REPORT; candidate += LIST_GROUP) {
        const uint searched = find_owner(
            starts, offsets, run_bits, visible, candidates, candidate, &found);
        STEPS(searched + 1);
        const uint gaussian = order[found.rank];
        const uint4 cover = covers[gaussian];
        if (is_large(cover)
            && tile_of_candidate(
                   cover, records + (size_t)gaussian * REC_SIZE, (uint)(candidate - found.first), 0)
                < 0)
            continue;
        if (++pairs % PAIRS_PER_REPORT == 0)
            atomic_inc(reports);
    }
    scan_group(&memory, pairs, &total);
    /* Beyond the limit the exact number does not matter, but it must not overflow. */
    if (get_local_id(0) == 0)
        chunk_pairs[chunk] = total > pair_limit ? pair_limit + 1 : (uint)total;
    END_STEPS(counters);
}

/* tiles[slot] and gaussians[slot] of every pair, and each Gaussian's slots; `slot_count` must be 0 before.
 * Does nothing if the arrays are too small. */
__kernel __attribute__((reqd_work_group_size(LIST_GROUP, 1, 1))) void emit_pairs(
    __global const real *records, __global const uint4 *covers, __global const uint *order,
    __global const ulong *offsets, __global const ulong *totals, __global const uint *chunk_pairs,
    __global uint *tiles, __global uint *gaussians, __global uint *slot_start,
    __global uint *slot_count, __global ulong *counters, uint runs, uint run_bits, int tiles_x,
    uint pair_capacity)
{
    __local scan_memory memory;
    __local ulong starts[LIST_GROUP];
    BEGIN_STEPS;
    const uint id = get_local_id(0);
    const size_t chunks = get_num_groups(0), chunk = get_group_id(0);
    const uint visible = (uint)counters[COUNT_VISIBLE];
    const ulong candidates = starts_of_runs(&memory, starts, totals, runs);
    ulong earlier = 0, others = 0, slot, pairs;
    for (size_t other = id; other < chunks; other += LIST_GROUP) {
        earlier += other < chunk ? chunk_pairs[other] : 0;
        others += chunk_pairs[other];
        STEPS(1);
    }
    scan_group(&memory, earlier, &slot);
    scan_group(&memory, others, &pairs);
    if (chunk == 0 && id == 0)
        counters[COUNT_PAIRS] = pairs;
    if (pairs > pair_capacity)
        return;
    const ulong begin = candidates * chunk / chunks, end = candidates * (chunk + 1) / chunks;
    owner found = {0, 0, 0};
    for (ulong batch = begin; batch < end; batch += LIST_GROUP) {
        const ulong candidate = batch + id;
        int tile = -1, is_first = 0;
        uint gaussian = 0;
        uint4 cover = (uint4)(0);
        if (candidate < end) {
            const uint searched = find_owner(
                starts, offsets, run_bits, visible, candidates, candidate, &found);
            STEPS(searched + 6);
            gaussian = order[found.rank];
            cover = covers[gaussian];
            is_first = candidate == found.first;
            tile = tile_of_candidate(
                cover, records + (size_t)gaussian * REC_SIZE, (uint)(candidate - found.first),
                tiles_x);
        }
        ulong total;
        const uint own = (uint)(slot + scan_group(&memory, tile >= 0, &total));
        STEPS(SCAN_STEPS);
        slot += total;
        if (is_first)
            slot_start[gaussian] = own;
        if (is_first && !is_large(cover))
            slot_count[gaussian] = candidates_of(cover);
        if (tile >= 0) {
            tiles[own] = tile;
            gaussians[own] = gaussian;
            if (is_large(cover))
                atomic_inc(slot_count + gaussian); /* the order of additions does not matter */
        }
    }
    END_STEPS(counters);
}

/* From the pairs' slots in the order of their tiles: the lists, and where each tile's begins. */
__kernel __attribute__((reqd_work_group_size(LIST_GROUP, 1, 1))) void finish_lists(
    __global const uint *tiles, __global const uint *slots, __global const uint *gaussians,
    __global uint *tile_starts, __global uint2 *pairs, __global ulong *counters, uint tile_count,
    uint pair_capacity)
{
    BEGIN_STEPS;
    const size_t found = counters[COUNT_PAIRS];
    if (found > pair_capacity)
        return;
    for (size_t tile = get_global_id(0); tile <= tile_count; tile += get_global_size(0)) {
        size_t low = 0, beyond = found; /* the first pair of this tile or a later one */
        while (low < beyond) {
            const size_t middle = low + (beyond - low) / 2;
            if (tiles[middle] < tile)
                low = middle + 1;
            else
                beyond = middle;
            STEPS(1);
        }
        tile_starts[tile] = (uint)low;
    }
    for (size_t p = get_global_id(0); p < found; p += get_global_size(0)) {
        pairs[p] = (uint2)(gaussians[slots[p]], slots[p]);
        STEPS(1);
    }
    END_STEPS(counters);
}
