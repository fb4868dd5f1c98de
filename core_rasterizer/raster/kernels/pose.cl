/* The gradient of the camera's pose: each block of Gaussians writes its part, a fixed number of chunks sums
 * these, and raster/pose.py sums the chunks. Twin: autograd through reference.py. */

/* Sum over the lanes of a block, in order; overflowed values count as 0. */
static inline wide sum_of_seen(lane value, lane_mask visible)
{
    value = visible & (lane_abs(value) < (lane)REAL_LARGEST) ? value : (lane)0;
    wide sum = 0;
    for (int l = 0; l < LANES; l++)
        sum += LANE_AT(value, l);
    return sum;
}

/* The pose [R | t] enters x = R m + t, U = R Q (the camera-from-Gaussian rotation), and the camera centre,
 * whose part is linear in the sum of `d_view`. */
static inline void store_pose_sums(
    __global wide *pose_sums, const projected *g, __global const real *parameters, size_t capacity,
    size_t i, lane_mask visible, const lane *d_camera, const lane *d_u, const lane *d_view)
{
    lane rotation[9];
    rotation_of(g->qw, g->qx, g->qy, g->qz, rotation);
    for (int j = 0; j < 3; j++) {
        for (int k = 0; k < 3; k++) {
            const lane mean = LOAD_GLOBAL(parameters + (ROW_MEAN + k) * capacity + i);
            const lane value = d_camera[j] * mean + d_u[3 * j] * rotation[3 * k]
                + d_u[3 * j + 1] * rotation[3 * k + 1] + d_u[3 * j + 2] * rotation[3 * k + 2];
            pose_sums[POSE_ROTATION + 3 * j + k] = sum_of_seen(value, visible);
        }
        pose_sums[POSE_TRANSLATION + j] = sum_of_seen(d_camera[j], visible);
        pose_sums[POSE_VIEW + j] = sum_of_seen(d_view[j], visible);
    }
}

/* chunk_sums[chunk][k]: the blocks of a chunk in their order. */
__kernel __attribute__((reqd_work_group_size(1, POSE_SIZE, 1))) void sum_poses(
    __global const wide *pose_sums, __global wide *chunk_sums, uint blocks)
{
    const size_t chunks = get_global_size(0), chunk = get_global_id(0), k = get_global_id(1);
    wide sum = 0;
    for (size_t b = blocks * chunk / chunks; b < blocks * (chunk + 1) / chunks; b++)
        sum += pose_sums[b * POSE_SIZE + k];
    chunk_sums[chunk * POSE_SIZE + k] = sum;
}
