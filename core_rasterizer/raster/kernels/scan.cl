/* Exclusive prefix sums over a table counts[chunk][bucket], in two steps so that both CPUs and GPUs
 * have parallel work: per bucket over the chunks, then over the buckets. Sums are exact integers, so
 * the result does not depend on the number of chunks. */

__kernel __attribute__((reqd_work_group_size(SCAN_GROUP, 1, 1))) void scan_chunks(
    __global uint *counts, __global uint *totals, uint buckets, uint chunks)
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

/* One work-group. Turns totals into exclusive starts and stores the grand total, in 64 bits. Each
 * work-item sums its share of neighbouring buckets, then the shares before it. */
__kernel __attribute__((reqd_work_group_size(SCAN_ITEMS, 1, 1))) void scan_buckets(
    __global uint *totals, __global ulong *counters, uint buckets, uint counter)
{
    __local ulong shares[SCAN_ITEMS];
    const uint id = get_local_id(0);
    const uint begin = (uint)((ulong)buckets * id / SCAN_ITEMS);
    const uint end = (uint)((ulong)buckets * (id + 1) / SCAN_ITEMS);
    ulong sum = 0;
    for (uint bucket = begin; bucket < end; bucket++)
        sum += totals[bucket];
    shares[id] = sum;
    barrier(CLK_LOCAL_MEM_FENCE);
    sum = 0;
    for (uint before = 0; before < id; before++)
        sum += shares[before];
    for (uint bucket = begin; bucket < end; bucket++) {
        const uint here = totals[bucket];
        totals[bucket] = (uint)sum;
        sum += here;
    }
    if (id == SCAN_ITEMS - 1) {
        totals[buckets] = (uint)sum;
        counters[counter] = sum;
    }
}
