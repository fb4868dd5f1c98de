/* Stable radix sort on a GPU, of Gaussians by depth and of pairs by tile. A work-group takes a chunk of
 * neighbouring elements, one element per work-item at a time. counts[digit][chunk], in this order, so that
 * one prefix sum over the whole table gives each chunk the place of its first element of each digit. */

#define MAX_DIGITS (1u << DIGIT_BITS)
#define NO_DIGIT MAX_DIGITS /* of elements that are invisible or beyond the chunk */

/* Number of elements: `limit`, or where `counter` names one, its value; 0 if that exceeds the limit, because
 * the arrays are too small then. */
static inline size_t elements_of(__global const ulong *counters, int counter, uint limit)
{
    if (counter < 0)
        return limit;
    return counters[counter] > limit ? 0 : counters[counter];
}

static inline uint digit_at(
    __global const uint *keys, size_t i, size_t end, uint shift, uint digits)
{
    if (i >= end || keys[i] == INVISIBLE)
        return NO_DIGIT;
    return (keys[i] >> shift) & (digits - 1);
}

__kernel __attribute__((reqd_work_group_size(LIST_GROUP, 1, 1))) void count_digits(
    __global const uint *keys, __global uint *counts, __global ulong *counters, int counter,
    uint limit, uint shift, uint digits)
{
    __local uint found[MAX_DIGITS];
    BEGIN_STEPS;
    const uint id = get_local_id(0);
    const size_t chunks = get_num_groups(0), chunk = get_group_id(0);
    for (uint digit = id; digit < digits; digit += LIST_GROUP)
        found[digit] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    const size_t elements = elements_of(counters, counter, limit);
    const size_t begin = elements * chunk / chunks, end = elements * (chunk + 1) / chunks;
    for (size_t i = begin + id; i < end; i += LIST_GROUP) {
        const uint digit = digit_at(keys, i, end, shift, digits);
        if (digit != NO_DIGIT)
            atomic_inc(found + digit); /* the order of additions does not matter */
        STEPS(1);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint digit = id; digit < digits; digit += LIST_GROUP) {
        counts[digit * chunks + chunk] = found[digit];
        STEPS(2);
    }
    END_STEPS(counters);
}

/* `first`: the values to sort are the elements' indices. Writes COUNT_VISIBLE where no counter is named. */
__kernel __attribute__((reqd_work_group_size(LIST_GROUP, 1, 1))) void scatter_digits(
    __global const uint *keys, __global const uint *values, __global uint *keys_out,
    __global uint *values_out, __global const uint *counts, __global const ulong *totals,
    __global ulong *counters, int counter, uint limit, uint shift, uint digits, uint first,
    uint runs, uint run_bits)
{
    __local scan_memory memory;
    __local ulong starts[LIST_GROUP];
    __local uint next[MAX_DIGITS]; /* index of the chunk's next element of each digit */
    __local uint batch_digits[LIST_GROUP];
    BEGIN_STEPS;
    const uint id = get_local_id(0);
    const size_t chunks = get_num_groups(0), chunk = get_group_id(0);
    const ulong kept = starts_of_runs(&memory, starts, totals, runs);
    for (uint digit = id; digit < digits; digit += LIST_GROUP) {
        const size_t at = digit * chunks + chunk;
        next[digit] = (uint)(starts[at >> run_bits] + counts[at]);
        STEPS(1);
    }
    const size_t elements = elements_of(counters, counter, limit);
    const size_t begin = elements * chunk / chunks, end = elements * (chunk + 1) / chunks;
    for (size_t batch = begin; batch < end; batch += LIST_GROUP) {
        const size_t i = batch + id;
        const uint digit = digit_at(keys, i, end, shift, digits);
        batch_digits[id] = digit;
        barrier(CLK_LOCAL_MEM_FENCE);
        uint to = digit != NO_DIGIT ? next[digit] : 0;
        for (uint other = 0; other < id; other++)
            to += batch_digits[other] == digit;
        STEPS(id);
        barrier(CLK_LOCAL_MEM_FENCE);
        if (digit != NO_DIGIT) {
            atomic_inc(next + digit); /* the order of additions does not matter */
            keys_out[to] = keys[i];
            values_out[to] = first ? (uint)i : values[i];
        }
    }
    if (counter < 0 && chunk == 0 && id == 0)
        counters[COUNT_VISIBLE] = kept;
    END_STEPS(counters);
}
