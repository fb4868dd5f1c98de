/* Stable radix sort of the visible Gaussians by depth on a GPU: as in sort.cl, with one work-group per
 * chunk, which processes it in batches of one element per work-item. */

#define BUCKETS (1u << DIGIT_BITS)
#define NO_DIGIT BUCKETS /* of elements that are invisible or beyond the chunk */

/* The first pass sorts all `count` Gaussians and drops the invisible ones; later passes sort the
 * COUNT_VISIBLE that are left. */
static inline void chunk_bounds(
    __global const ulong *counters, uint count, uint first, size_t *begin, size_t *end)
{
    const size_t elements = first ? count : counters[COUNT_VISIBLE];
    const size_t chunks = get_num_groups(0), chunk = get_group_id(0);
    *begin = elements * chunk / chunks;
    *end = elements * (chunk + 1) / chunks;
}

static inline uint digit_at(__global const uint *keys, size_t i, size_t end, uint shift)
{
    if (i >= end || keys[i] == INVISIBLE)
        return NO_DIGIT;
    return (keys[i] >> shift) & (BUCKETS - 1);
}

__kernel __attribute__((reqd_work_group_size(CHUNK_GROUP, 1, 1)))
void count_digits(
    __global const uint *keys, __global uint *counts, __global const ulong *counters, uint count,
    uint shift, uint first)
{
    __local uint found[BUCKETS];
    const uint id = get_local_id(0);
    for (uint bucket = id; bucket < BUCKETS; bucket += CHUNK_GROUP)
        found[bucket] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    size_t begin, end;
    chunk_bounds(counters, count, first, &begin, &end);
    for (size_t i = begin + id; i < end; i += CHUNK_GROUP) {
        const uint digit = digit_at(keys, i, end, shift);
        if (digit != NO_DIGIT)
            atomic_inc(found + digit); /* the order of additions does not matter */
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    __global uint *mine = counts + get_group_id(0) * BUCKETS;
    for (uint bucket = id; bucket < BUCKETS; bucket += CHUNK_GROUP)
        mine[bucket] = found[bucket];
}

__kernel __attribute__((reqd_work_group_size(CHUNK_GROUP, 1, 1)))
void scatter_digits(
    __global const uint *keys, __global const uint *order, __global uint *keys_out,
    __global uint *order_out, __global const uint *counts, __global const uint *starts,
    __global const ulong *counters, uint count, uint shift, uint first)
{
    __local uint next[BUCKETS]; /* index of the chunk's next element of each bucket */
    __local uint digits[CHUNK_GROUP];
    const uint id = get_local_id(0);
    __global const uint *mine = counts + get_group_id(0) * BUCKETS;
    for (uint bucket = id; bucket < BUCKETS; bucket += CHUNK_GROUP)
        next[bucket] = mine[bucket] + starts[bucket];
    size_t begin, end;
    chunk_bounds(counters, count, first, &begin, &end);
    for (size_t batch = begin; batch < end; batch += CHUNK_GROUP) {
        const size_t i = batch + id;
        const uint digit = digit_at(keys, i, end, shift);
        digits[id] = digit;
        barrier(CLK_LOCAL_MEM_FENCE);
        uint to = 0;
        int is_last = digit != NO_DIGIT;
        if (digit != NO_DIGIT) {
            to = next[digit];
            for (uint other = 0; other < CHUNK_GROUP; other++) {
                to += other < id && digits[other] == digit;
                is_last &= other <= id || digits[other] != digit;
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        if (is_last)
            next[digit] = to + 1;
        if (digit != NO_DIGIT) {
            keys_out[to] = keys[i];
            order_out[to] = first ? (uint)i : order[i];
        }
    }
}
