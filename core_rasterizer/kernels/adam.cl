/* One step of Adam (Kingma & Ba 2015), over `[rows][capacity]` arrays. Twin: torch.optim.Adam.
 *
 * Work-items of dimension 1 take a row each, a row being one scalar parameter of all Gaussians; those
 * of dimension 0 share its columns, `span` neighbouring ones each. It is bound by memory: one pass
 * reads four arrays and writes three.
 *
 * `rates` are learning rates over the first bias correction; `correction` is 1 / sqrt of the second.
 */

#define BETA1 ((real)0.9)
#define BETA2 ((real)0.999)
#define EPSILON ((real)1e-15)

__kernel void adam(
    __global real *parameters, __global const real *gradients,
    __global real *first_moments, __global real *second_moments, __global const real *rates,
    real correction, int columns, int capacity, int span)
{
    const size_t row = get_global_id(1);
    const int begin = get_global_id(0) * span;
    const int end = begin + span < columns ? begin + span : columns;
    const real rate = rates[row];
    for (int column = begin; column < end; column += LANES) {
        const size_t at = row * capacity + column;
        const lane gradient = LOAD_GLOBAL(gradients + at);
        const lane m = BETA1 * LOAD_GLOBAL(first_moments + at) + (1 - BETA1) * gradient;
        const lane v = BETA2 * LOAD_GLOBAL(second_moments + at) + (1 - BETA2) * gradient * gradient;
        STORE_GLOBAL(first_moments + at, m);
        STORE_GLOBAL(second_moments + at, v);
        const lane change = rate * m / (lane_sqrt(v) * correction + EPSILON);
        STORE_GLOBAL(parameters + at, LOAD_GLOBAL(parameters + at) - change);
    }
}
