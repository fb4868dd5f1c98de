/* Prefix sums on a GPU: over the work-items of a group, and over the totals of up to LIST_GROUP runs, so that a
 * prefix sum over a long array needs one launch, not two. Sums are exact integers, so results do not depend
 * on how an array is divided. */

/* A divisor of LIST_GROUP; a work-item adds at most three times as many values. */
#define SCAN_ROOT 16
#define SCAN_PARTS (LIST_GROUP / SCAN_ROOT)

typedef struct {
    ulong values[LIST_GROUP], parts[SCAN_PARTS];
} scan_memory;

/* With COUNT_STEPS, which tests define, the largest number of steps that one work-item takes is kept in the
 * last of the counters. */
#ifdef COUNT_STEPS
#define STEPS(n) (steps += (n))
#define BEGIN_STEPS uint steps = 0
#define END_STEPS(counters) atomic_max((volatile __global uint *)((counters) + COUNT_LAST), steps)
#else
#define STEPS(n) ((void)(n))
#define BEGIN_STEPS
#define END_STEPS(counters)
#endif
#define SCAN_STEPS (2 * SCAN_ROOT + SCAN_PARTS)

/* The sum of the values of all work-items before this one; `total` is the sum of all. */
static inline ulong scan_group(__local scan_memory *memory, ulong value, ulong *total)
{
    const uint id = get_local_id(0);
    barrier(CLK_LOCAL_MEM_FENCE); /* the last call's values have been read */
    memory->values[id] = value;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (id < SCAN_PARTS) {
        ulong sum = 0;
        for (uint k = id * SCAN_ROOT; k < (id + 1) * SCAN_ROOT; k++)
            sum += memory->values[k];
        memory->parts[id] = sum;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    ulong before = 0, sum = 0;
    for (uint part = 0; part < SCAN_PARTS; part++) {
        before += part < id / SCAN_ROOT ? memory->parts[part] : 0;
        sum += memory->parts[part];
    }
    for (uint k = id / SCAN_ROOT * SCAN_ROOT; k < id; k++)
        before += memory->values[k];
    *total = sum;
    return before;
}

/* starts[run]: the sum of the totals before it. Returns the sum of all. */
static inline ulong starts_of_runs(
    __local scan_memory *memory, __local ulong *starts, __global const ulong *totals, uint runs)
{
    ulong total;
    const uint id = get_local_id(0);
    starts[id] = scan_group(memory, id < runs ? totals[id] : 0, &total);
    barrier(CLK_LOCAL_MEM_FENCE);
    return total;
}

/* Turns each run of 2^run_bits entries into exclusive prefix sums. */
__kernel __attribute__((reqd_work_group_size(LIST_GROUP, 1, 1))) void scan_runs(
    __global uint *table, __global ulong *totals, uint entries, uint run_bits)
{
    __local scan_memory memory;
    const size_t begin = (size_t)get_group_id(0) << run_bits;
    const size_t end = min((size_t)entries, begin + ((size_t)1 << run_bits));
    ulong carry = 0, total;
    for (size_t batch = begin; batch < end; batch += LIST_GROUP) {
        const size_t at = batch + get_local_id(0);
        const ulong before = scan_group(&memory, at < end ? table[at] : 0, &total);
        if (at < end)
            table[at] = (uint)(carry + before);
        carry += total;
    }
    if (get_local_id(0) == 0)
        totals[get_group_id(0)] = carry;
}
