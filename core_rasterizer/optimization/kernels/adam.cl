/* One step of Adam over `[rows][capacity]` arrays.
 *
 * Work-items of dimension 1 take a row each, a row being one scalar parameter of all Gaussians; those
 * of dimension 0 share its columns, `span` neighbouring ones each. It is limited by memory: one pass
 * reads four arrays and writes three.
 *
 * Groups without their bit in `moving` are skipped. `undefined` is set to 1 if a parameter is not finite after
 * the step.
 */

static inline int any_gradient(__global const real *gradients)
{
    int any = 0;
    for (int l = 0; l < BLOCK; l++)
        any |= gradients[l] != 0;
    return any;
}

__kernel void adam(
    __global real *restrict parameters, __global const real *restrict gradients,
    __global real *restrict first_moments, __global real *restrict second_moments, ADAM_RATES,
    int moving, int columns, int capacity, int span, __global int *undefined)
{
    const size_t row = get_global_id(1);
    const int begin = get_global_id(0) * span;
    const int end = begin + span < columns ? begin + span : columns;
    const int group = ADAM_GROUP_OF(row);
    if ((moving >> group & 1) == 0)
        return;
    ADAM_RATES_BY_GROUP
    const real rate = rates[group], correction = corrections[group];
    const size_t first = row * capacity;
    int found = 0;
#if VISIBLE_ONLY
    for (size_t at = first + begin; at < first + end; at += BLOCK)
        if (any_gradient(gradients + at))
            found |= step_values(
                parameters, gradients, first_moments, second_moments, at, at + BLOCK, rate,
                correction);
#else
    found = step_values(
        parameters, gradients, first_moments, second_moments, first + begin, first + end, rate,
        correction);
#endif
    if (row == ROW_OPACITY)
        limit_logits(parameters, first + begin, first + end);
    if (found)
        *undefined = 1;
}
