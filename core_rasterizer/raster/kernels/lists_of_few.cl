/* sort.cl and bin.cl in one launch by one work-item: with few Gaussians, launches and waits cost more than
 * the work. The lists are bit-identical. */

/* Counts become starts; returns their sum. */
static inline uint starts_of(__global uint *counts, uint buckets)
{
    uint sum = 0;
    for (uint bucket = 0; bucket < buckets; bucket++) {
        const uint here = counts[bucket];
        counts[bucket] = sum;
        sum += here;
    }
    return sum;
}

__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void lists_of_few(
    __global const real *records, __global const uint4 *covers, __global const uint *keys,
    __global uint *keys_a, __global uint *order_a, __global uint *keys_b, __global uint *order_b,
    __global uint *counts, __global uint *tile_starts, __global uint2 *pairs,
    __global uint *slot_start, __global uint *slot_count, __global ulong *counters, uint count,
    uint tiles, int tiles_x, uint pair_limit, uint pair_capacity)
{
    count_digits_in(keys, counts, 0, count, 0);
    const uint visible = starts_of(counts, BUCKETS);
    scatter_digits_in(keys, keys, keys_a, order_a, counts, 0, count, 0, 1);
    count_digits_in(keys_a, counts, 0, visible, DIGIT_BITS);
    starts_of(counts, BUCKETS);
    scatter_digits_in(keys_a, order_a, keys_b, order_b, counts, 0, visible, DIGIT_BITS, 0);
    count_digits_in(keys_b, counts, 0, visible, 2 * DIGIT_BITS);
    starts_of(counts, BUCKETS);
    scatter_digits_in(keys_b, order_b, keys_a, order_a, counts, 0, visible, 2 * DIGIT_BITS, 0);

    /* The first element of keys_b is free now and counts the reports. */
    keys_b[0] = 0;
    const uint found = count_tiles_in(
        records, covers, order_a, tile_starts, keys_b, 0, visible, tiles, tiles_x, pair_limit);
    tile_starts[tiles] = starts_of(tile_starts, tiles);
    counters[COUNT_VISIBLE] = visible;
    counters[COUNT_PAIRS] = found;
    if (found > pair_capacity)
        return;
    for (uint tile = 0; tile < tiles; tile++)
        counts[tile] = tile_starts[tile];
    fill_tiles_in(
        records, covers, order_a, counts, pairs, slot_start, slot_count, 0, visible, 0, tiles_x);
}
