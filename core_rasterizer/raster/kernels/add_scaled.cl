/* total = factor * values, or that is added to it. */
__kernel void add_scaled(
    __global const real *values, __global real *total, real factor, int add, int count)
{
    const int i = get_global_id(0);
    if (i < count)
        total[i] = factor * values[i] + (add ? total[i] : 0);
}
