/* Exclusive prefix sums over a table counts[chunk][bucket], in two steps so that both CPUs and GPUs
 * have parallel work: per bucket over the chunks, then over the buckets. Sums are exact integers, so
 * the result does not depend on the number of chunks. */

__kernel __attribute__((reqd_work_group_size(SCAN_GROUP, 1, 1)))
void scan_chunks(__global uint *counts, __global uint *totals, uint buckets, uint chunks)
{
    const size_t bucket = get_global_id(0);
    if (bucket >= buckets)
        return;
    uint sum = 0;
    for (uint chunk = 0; chunk < chunks; chunk++) {
        const size_t at = (size_t)chunk * buckets + bucket;
        const uint here = counts[at];
        counts[at] = sum;
        sum += here;
    }
    totals[bucket] = sum;
}

/* One work-item. Turns totals into exclusive starts and stores the grand total, in 64 bits. */
__kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void scan_buckets(__global uint *totals, __global ulong *counters, uint buckets, uint counter)
{
    ulong sum = 0;
    for (uint bucket = 0; bucket < buckets; bucket++) {
        const uint here = totals[bucket];
        totals[bucket] = (uint)sum;
        sum += here;
    }
    totals[buckets] = (uint)sum;
    counters[counter] = sum;
}
