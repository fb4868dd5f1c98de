/* Stable radix sort of the visible Gaussians by depth, DIGIT_BITS bits per pass, one work-item per chunk
 * of neighbouring elements. Equal keys keep their order, so the lower index comes first. */

#define BUCKETS (1u << DIGIT_BITS)

/* The first pass sorts all `count` Gaussians and drops the invisible ones; later passes sort the
 * COUNT_VISIBLE that are left. */
static inline void chunk_bounds(
    __global const ulong *counters, uint count, uint first, size_t *begin, size_t *end)
{
    const size_t elements = first ? count : counters[COUNT_VISIBLE];
    const size_t chunks = get_global_size(0), chunk = get_global_id(0);
    *begin = elements * chunk / chunks;
    *end = elements * (chunk + 1) / chunks;
}

static inline void count_digits_in(
    __global const uint *keys, __global uint *mine, size_t begin, size_t end, uint shift)
{
    for (uint bucket = 0; bucket < BUCKETS; bucket++)
        mine[bucket] = 0;
    for (size_t i = begin; i < end; i++)
        if (keys[i] != INVISIBLE)
            mine[(keys[i] >> shift) & (BUCKETS - 1)]++;
}

/* `mine` holds the index of the chunk's first element of each bucket. */
static inline void scatter_digits_in(
    __global const uint *keys, __global const uint *order, __global uint *keys_out,
    __global uint *order_out, __global uint *mine, size_t begin, size_t end, uint shift, uint first)
{
    for (size_t i = begin; i < end; i++) {
        const uint key = keys[i];
        if (key == INVISIBLE)
            continue;
        const uint to = mine[(key >> shift) & (BUCKETS - 1)]++;
        keys_out[to] = key;
        order_out[to] = first ? (uint)i : order[i];
    }
}

__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void count_digits(
    __global const uint *keys, __global uint *counts, __global const ulong *counters, uint count,
    uint shift, uint first)
{
    size_t begin, end;
    chunk_bounds(counters, count, first, &begin, &end);
    count_digits_in(keys, counts + get_global_id(0) * BUCKETS, begin, end, shift);
}

__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void scatter_digits(
    __global const uint *keys, __global const uint *order, __global uint *keys_out,
    __global uint *order_out, __global uint *counts, __global const uint *starts,
    __global const ulong *counters, uint count, uint shift, uint first)
{
    __global uint *mine = counts + get_global_id(0) * BUCKETS;
    for (uint bucket = 0; bucket < BUCKETS; bucket++)
        mine[bucket] += starts[bucket];
    size_t begin, end;
    chunk_bounds(counters, count, first, &begin, &end);
    scatter_digits_in(keys, order, keys_out, order_out, mine, begin, end, shift, first);
}
