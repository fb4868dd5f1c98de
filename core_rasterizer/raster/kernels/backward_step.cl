/* Backward, last stage, and a step of Adam in one pass, for iterations in which nobody reads the gradients: they
 * stay in private memory. The same bits as `project_backward` followed by `adam`.
 *
 * A work-item first differentiates PROJECT_SPAN Gaussians, then steps them row by row, so that each row is
 * a run of neighbouring addresses; interleaved, 177 rows are more streams than caches and TLB follow. */

/* Moments are read once, after the gradients: fetch a part of them with each block. To read, since fetching
 * them to write took longer (Zen 4). */
static inline void prefetch_moments(
    __global const real *first_moments, __global const real *second_moments, size_t capacity,
    size_t begin, int block, int rows)
{
    for (int row = block; row < rows; row += PROJECT_SPAN / LANES)
        for (int k = 0; k < PROJECT_SPAN; k += CAPACITY_STEP) {
            const size_t at = row * capacity + begin + k;
            PREFETCH_LATER(first_moments + at);
            PREFETCH_LATER(second_moments + at);
        }
}

static inline void prefetch_row(
    __global const real *first_moments, __global const real *second_moments)
{
    for (int k = 0; k < PROJECT_SPAN; k += CAPACITY_STEP) {
        PREFETCH(first_moments + k);
        PREFETCH(second_moments + k);
    }
}

__kernel __attribute__((reqd_work_group_size(PROJECT_GROUP, 1, 1))) void project_backward_and_step(
    __global real *restrict parameters, __global const real *modifiers, __global const wide *camera,
    __global const uchar *clamped, __global const real *pair_sums, __global const uint *slot_start,
    __global const uint *slot_count, __global real *statistics, uint count, uint capacity,
    int degree, int modified, int collect, int detached, __global real *restrict first_moments,
    __global real *restrict second_moments, ADAM_RATES, int moving, int rows,
    __global int *undefined)
{
    const size_t begin = get_global_id(0) * PROJECT_SPAN;
    if (begin >= capacity)
        return;
    const int size /* a constant on a GPU */
        = PROJECT_SPAN == 1 || begin + PROJECT_SPAN < capacity ? PROJECT_SPAN : capacity - begin;
    real gradients[MAX_ROWS * PROJECT_SPAN] __attribute__((aligned(64)));
    const int written = ROW_SH + 3 * (degree + 1) * (degree + 1);
    for (int block = 0; block < size / LANES; block++) {
        prefetch_moments(first_moments, second_moments, capacity, begin, block, rows);
        backward_of_block(
            parameters, modifiers, camera, clamped, pair_sums, slot_start, slot_count,
            gradients + block * LANES, PROJECT_SPAN, statistics, count, capacity, degree, 0,
            modified, 0, collect, detached, 0, begin + block * LANES);
    }
#if LANES == 1
#pragma unroll
#endif
    for (int k = UP_TO(written * PROJECT_SPAN, 0); k < UP_TO(rows, MAX_ROWS) * PROJECT_SPAN; k++)
        if (k >= written * PROJECT_SPAN)
            gradients[k] = 0;
    ADAM_RATES_BY_GROUP
    int found = 0;
#if LANES == 1
#pragma unroll
#endif
    for (int row = 0; row < UP_TO(rows, MAX_ROWS); row++) {
        const int group = ADAM_GROUP_OF(row);
        if (row >= rows || (moving >> group & 1) == 0)
            continue;
        const size_t at = row * (size_t)capacity + begin;
        prefetch_row(first_moments + at + capacity, second_moments + at + capacity);
        found |= step_values(
            parameters + at, gradients + row * PROJECT_SPAN, first_moments + at,
            second_moments + at, 0, size, rates[group], corrections[group]);
        if (row == ROW_OPACITY)
            limit_logits(parameters + at, 0, size);
    }
    if (found)
        *undefined = 1;
}
