/* Gather and append columns of a [rows][capacity] array, and draw the children of splits. */

/* target[row][j] = values[row][source[j]]; columns beyond `count`, and those with zero[j], are zero. */
__kernel __attribute__((reqd_work_group_size(TOPOLOGY_GROUP, 1, 1))) void gather_columns(
    __global const real *values, __global const uint *source, __global const uint *zero,
    __global real *target, uint count, uint capacity, uint target_capacity, uint rows)
{
    const size_t j = get_global_id(0);
    if (j >= target_capacity)
        return;
    const int keep = j < count && !zero[j];
    const size_t from = keep ? source[j] : 0;
    for (uint row = 0; row < rows; row++)
        target[(size_t)row * target_capacity + j] = keep ? values[(size_t)row * capacity + from]
                                                         : 0;
}

/* target[row][first + j] = values[row][j], for j below `columns`. */
__kernel __attribute__((reqd_work_group_size(TOPOLOGY_GROUP, 1, 1))) void append_columns(
    __global const real *values, __global real *target, uint first, uint columns,
    uint target_capacity, uint rows)
{
    const size_t j = get_global_id(0);
    if (j >= columns)
        return;
    for (uint row = 0; row < rows; row++)
        target[(size_t)row * target_capacity + first + j] = values[(size_t)row * columns + j];
}

#define MAX_LOG_SCALE ((real)80) /* e^80 times the noise is finite */

/* A child of a split is drawn from its parent: mean += R S noise, then the scale shrinks. */
__kernel __attribute__((reqd_work_group_size(TOPOLOGY_GROUP, 1, 1))) void spread_children(
    __global real *parameters, __global const real *noise, uint first, uint children, uint capacity,
    real shrink)
{
    const size_t child = get_global_id(0);
    if (child >= children)
        return;
    __global real *row = parameters + first + child;
    const size_t stride = capacity;
    real w = row[ROW_QUATERNION * stride], x = row[(ROW_QUATERNION + 1) * stride],
         y = row[(ROW_QUATERNION + 2) * stride], z = row[(ROW_QUATERNION + 3) * stride];
    /* As in projection.cl: the largest component first, so that no square overflows. */
    const real largest = fmax(fmax(fabs(w), fabs(x)), fmax(fabs(y), fabs(z)));
    if (largest >= MIN_QUATERNION) {
        w /= largest, x /= largest, y /= largest, z /= largest;
        const real norm = sqrt(w * w + x * x + y * y + z * z);
        w /= norm, x /= norm, y /= norm, z /= norm;
    } else
        w = 1, x = y = z = 0;
    real offset[3];
    for (int k = 0; k < 3; k++)
        offset[k] = exp(fmin(row[(ROW_SCALE + k) * stride], MAX_LOG_SCALE)) * noise[3 * child + k];
    row[ROW_MEAN * stride] += (1 - 2 * (y * y + z * z)) * offset[0]
        + 2 * (x * y - w * z) * offset[1] + 2 * (x * z + w * y) * offset[2];
    row[(ROW_MEAN + 1) * stride] += 2 * (x * y + w * z) * offset[0]
        + (1 - 2 * (x * x + z * z)) * offset[1] + 2 * (y * z - w * x) * offset[2];
    row[(ROW_MEAN + 2) * stride] += 2 * (x * z - w * y) * offset[0]
        + 2 * (y * z + w * x) * offset[1] + (1 - 2 * (x * x + y * y)) * offset[2];
    for (int k = 0; k < 3; k++)
        row[(ROW_SCALE + k) * stride] -= log(shrink);
}
