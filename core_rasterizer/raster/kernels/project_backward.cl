/* Backward, last stage: sum a Gaussian's pair slots, then differentiate the projection. */

/* Built with STEP, gradients of a few Gaussians stay in private memory, for a step of Adam (backward_step.cl). */
#ifdef STEP
#define GRADIENT real
#define STORE_GRADIENT STORE
#else
#define GRADIENT __global real
#define STORE_GRADIENT STORE_GLOBAL
#endif

/* `collect`: 0 no statistics, 1 two rows, 2 a third row, which needs kernels with ABSOLUTE. */
#define COLLECT_ABSOLUTE 2

#define MAX_ROWS (ROW_SH + 48)

/* Sums the slots of each lane's Gaussian in slot order, which is fixed. */
static inline void sum_pairs(
    lane *sums, __global const real *pair_sums, __global const uint *slot_start,
    __global const uint *slot_count, size_t i)
{
#pragma unroll
    for (int k = 0; k < PAIR_SIZE; k++)
        sums[k] = (lane)0;
#pragma unroll
    for (int l = 0; l < LANES; l++) {
        const uint slots = slot_count[i + l]; /* where it is 0, slot_start is undefined */
        __global const real *slot = pair_sums + (size_t)(slots ? slot_start[i + l] : 0) * PAIR_SIZE;
        for (uint s = 0; s < slots; s++, slot += PAIR_SIZE)
#if LANES == 1
#pragma unroll
            for (int q = 0; q < PAIR_SIZE / 4; q++)
                vstore4(vload4(q, sums) + ((__global const quad *)slot)[q], q, sums);
#else
#pragma unroll
            for (int k = 0; k < PAIR_SIZE / LANES; k++)
                sums[k * LANES + l] += LOAD_GLOBAL(slot + k * LANES);
#endif
    }
#if LANES > 1
    transpose(sums);
    transpose(sums + LANES);
#endif
}

/* Slots are in depth order, Gaussians are not: without this, a third of the kernel's time is latency. An
 * undefined slot_start is harmless. */
static inline void prefetch_slots(__global const real *pair_sums, __global const uint *slot_start)
{
#pragma unroll
    for (int l = 0; l < LANES; l++)
        PREFETCH(pair_sums + (size_t)slot_start[l] * PAIR_SIZE);
}

/* Hardware does not prefetch sixty rows that are written either, and an uncached line is read before it is
 * written. Addresses beyond a row's end are harmless. */
static inline void prefetch_gradients(
    __global const real *gradients, size_t capacity, size_t i, int count)
{
    if (LANES > 1 && i % 16 == 0) /* a cache line */
        for (int row = 0; row < count; row++)
            PREFETCH_TO_WRITE(gradients + row * capacity + ROWS_AHEAD);
}

/* Overflowed gradients become 0, so that optimizer steps stay finite. */
static inline lane finite(lane value)
{
    return lane_abs(value) < (lane)REAL_LARGEST ? value : (lane)0;
}

static inline void put(GRADIENT *row, lane value, int accumulate)
{
#ifndef STEP
    if (accumulate)
        value += LOAD_GLOBAL(row);
#endif
    STORE_GRADIENT(row, finite(value));
}

static inline void add(__global real *row, lane value)
{
    STORE_GLOBAL(row, finite(value + LOAD_GLOBAL(row)));
}

/* Detached parameters get no gradient; rows that are overwritten must still be zeroed. */
static inline void put_unless(int detached, GRADIENT *row, lane value, int accumulate)
{
    if (!detached)
        put(row, value, accumulate);
    else if (!accumulate)
        STORE_GRADIENT(row, (lane)0);
}

/* Gradients of the SH coefficients; the path from view direction to mean is added to `d_mean` and stored in
 * `d_view`. */
static inline void color_backward(
    __global const real *parameters, GRADIENT *gradients, size_t gradient_stride, size_t capacity,
    size_t i, __global const wide *camera, int degree, const lane *d_color, lane_mask visible,
    int accumulate, int detached, lane *d_mean, lane *d_view)
{
    __global const real *row = parameters + i;
    lane dx = LOAD_GLOBAL(row + ROW_MEAN * capacity) - (real)camera[CAMERA_CENTER];
    lane dy = LOAD_GLOBAL(row + (ROW_MEAN + 1) * capacity) - (real)camera[CAMERA_CENTER + 1];
    lane dz = LOAD_GLOBAL(row + (ROW_MEAN + 2) * capacity) - (real)camera[CAMERA_CENTER + 2];
    const lane scale = visible ? 1 / lane_sqrt(dx * dx + dy * dy + dz * dz) : (lane)0;
    dx = visible ? dx * scale : (lane)0;
    dy = visible ? dy * scale : (lane)0;
    dz = visible ? dz * scale : (lane)0;
    lane basis[16], weight[16];
    sh_basis(basis, degree, dx, dy, dz);
    fade_last_band(basis, degree, camera);
    const int coefficients = (degree + 1) * (degree + 1);
#if LANES == 1
#pragma unroll
#endif
    for (int k = 0; k < UP_TO(coefficients, 16); k++) {
        if (k >= coefficients)
            continue;
        lane sum = (lane)0;
#pragma unroll
        for (int c = 0; c < 3; c++) {
            const size_t at = (ROW_SH + 3 * k + c) * capacity;
            if (k > 0)
                sum += d_color[c] * (visible ? LOAD_GLOBAL(row + at) : (lane)0);
            put_unless(
                detached & BIT_SH, gradients + (ROW_SH + 3 * k + c) * gradient_stride,
                basis[k] * d_color[c], accumulate);
        }
        weight[k] = sum;
    }
    fade_last_band(weight, degree, camera);
    lane gx = (lane)0, gy = (lane)0, gz = (lane)0;
    sh_direction_gradient(weight, degree, dx, dy, dz, &gx, &gy, &gz);
    const lane along = gx * dx + gy * dy + gz * dz;
#ifdef POSED
    d_view[0] = (gx - along * dx) * scale;
    d_view[1] = (gy - along * dy) * scale;
    d_view[2] = (gz - along * dz) * scale;
#endif
    d_mean[0] += (gx - along * dx) * scale;
    d_mean[1] += (gy - along * dy) * scale;
    d_mean[2] += (gz - along * dz) * scale;
}

/* dL/d(rotation matrix), row-major, to dL/d(quaternion as stored). */
static inline void rotation_backward(const projected *g, const lane *d, lane *d_quaternion)
{
    const lane w = g->qw, x = g->qx, y = g->qy, z = g->qz;
    lane q[4];
    q[0] = 2 * (x * (d[7] - d[5]) + y * (d[2] - d[6]) + z * (d[3] - d[1]));
    q[1] = 2 * (w * (d[7] - d[5]) + y * (d[1] + d[3]) + z * (d[2] + d[6]) - 2 * x * (d[4] + d[8]));
    q[2] = 2 * (w * (d[2] - d[6]) + x * (d[1] + d[3]) + z * (d[5] + d[7]) - 2 * y * (d[0] + d[8]));
    q[3] = 2 * (w * (d[3] - d[1]) + x * (d[2] + d[6]) + y * (d[5] + d[7]) - 2 * z * (d[0] + d[4]));
    const lane along = q[0] * w + q[1] * x + q[2] * y + q[3] * z;
    d_quaternion[0] = (q[0] - along * w) * g->inverse_norm;
    d_quaternion[1] = (q[1] - along * x) * g->inverse_norm;
    d_quaternion[2] = (q[2] - along * y) * g->inverse_norm;
    d_quaternion[3] = (q[3] - along * z) * g->inverse_norm;
}

#ifdef COMPENSATED
/* Adds the path from the logarithm of the opacity to the rows of J W R S through the determinant before
 * dilation, |a0 x a1|^2: the opacity is proportional to its square root. Cross products do not cancel, even
 * for thin ellipses. */
static inline void compensation_backward(
    const projected *g, int k, lane d_log_opacity, lane *d_a0, lane *d_a1)
{
    const int next = (k + 1) % 3, last = (k + 2) % 3;
    const lane *n = g->cross;
    const lane share = d_log_opacity / (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    *d_a0 += share * (g->a1[next] * n[last] - g->a1[last] * n[next]);
    *d_a1 += share * (n[next] * g->a0[last] - n[last] * g->a0[next]);
}
#endif

#ifdef SMOOTHED
/* From the smoothed scale to the parameter. The opacity is proportional to `shrinkage`, with
 * d log(shrinkage) / d log(scale) = `share`. */
static inline lane smoothing_backward(
    const projected *g, int k, lane d_log_opacity, int activated, lane d_scale)
{
    const lane kept = g->shrinkage[k], path = d_log_opacity * g->share[k];
    return activated ? d_scale * kept + path / (g->scale[k] * kept) : d_scale * kept * kept + path;
}
#endif

/* From dL/d(2D covariance) to the scales, the rotation, the camera-from-Gaussian rotation `d_u` and,
 * through the Jacobian, the mean. With filters, the opacity also depends on the scales. */
static inline void covariance_backward(
    const projected *g, lane d_xx, lane d_xy, lane d_yy, lane d_log_opacity, int activated,
    __global const wide *camera, lane *d_scale, lane *d_quaternion, lane *d_camera, lane *d_u)
{
    lane d_j00 = (lane)0, d_j02 = (lane)0, d_j11 = (lane)0, d_j12 = (lane)0;
#pragma unroll
    for (int k = 0; k < 3; k++) {
        lane d_a0 = 2 * d_xx * g->a0[k] + d_xy * g->a1[k];
        lane d_a1 = 2 * d_yy * g->a1[k] + d_xy * g->a0[k];
#ifdef COMPENSATED
        compensation_backward(g, k, d_log_opacity, &d_a0, &d_a1);
#endif
        const lane v0 = g->j00 * g->u[k] + g->j02 * g->u[6 + k];
        const lane v1 = g->j11 * g->u[3 + k] + g->j12 * g->u[6 + k];
        d_scale[k] = (d_a0 * v0 + d_a1 * v1) * (activated ? (lane)1 : g->scale[k]);
#ifdef SMOOTHED
        d_scale[k] = smoothing_backward(g, k, d_log_opacity, activated, d_scale[k]);
#endif
        const lane s0 = g->scale[k] * d_a0, s1 = g->scale[k] * d_a1;
        d_j00 += s0 * g->u[k];
        d_j02 += s0 * g->u[6 + k];
        d_j11 += s1 * g->u[3 + k];
        d_j12 += s1 * g->u[6 + k];
        d_u[k] = s0 * g->j00;
        d_u[3 + k] = s1 * g->j11;
        d_u[6 + k] = s0 * g->j02 + s1 * g->j12;
    }
    __global const wide *w = camera + CAMERA_ROTATION;
    real r[9];
#pragma unroll
    for (int k = 0; k < 9; k++)
        r[k] = w[k];
    lane d_rotation[9];
#pragma unroll
    for (int j = 0; j < 3; j++)
#pragma unroll
        for (int k = 0; k < 3; k++)
            d_rotation[3 * j + k] = r[j] * d_u[k] + r[3 + j] * d_u[3 + k] + r[6 + j] * d_u[6 + k];
    rotation_backward(g, d_rotation, d_quaternion);

    /* j02 = -f ratio / z; where clamped, the ratio is constant. */
    const lane inverse_z = 1 / g->z;
    d_camera[0] -= g->free_x ? d_j02 * g->j00 * inverse_z : (lane)0;
    d_camera[1] -= g->free_y ? d_j12 * g->j11 * inverse_z : (lane)0;
    d_camera[2] -= inverse_z
        * (d_j00 * g->j00 + d_j11 * g->j11 + d_j02 * g->j02 * (g->free_x ? (lane)2 : (lane)1)
           + d_j12 * g->j12 * (g->free_y ? (lane)2 : (lane)1));
}

/* Gradients of the block from column i on, which `gradients` points to, in rows of `gradient_stride`. */
static inline void backward_of_block(
    __global const real *parameters, __global const real *modifiers, __global const wide *camera,
    __global const uchar *clamped, __global const real *pair_sums, __global const uint *slot_start,
    __global const uint *slot_count, GRADIENT *gradients, size_t gradient_stride,
    __global real *statistics, uint count, uint capacity, int degree, int activated, int modified,
    int accumulate, int collect, int detached, __global wide *pose_sums, size_t i)
{
    const size_t stride = capacity;
#ifdef POSED
    pose_sums += i / LANES * POSE_SIZE;
    for (int k = 0; k < POSE_SIZE; k++)
        pose_sums[k] = 0;
#endif
    const int rows = ROW_SH + 3 * (degree + 1) * (degree + 1);
#ifndef STEP
    prefetch_gradients(gradients, stride, i, rows);
#endif
    int any = 0;
#pragma unroll
    for (int l = 0; l < LANES; l++)
        any |= slot_count[i + l] > 0;
    if (!any) {
#if LANES == 1
#pragma unroll
#endif
        for (int row = 0; row < UP_TO(rows, MAX_ROWS); row++)
            if (row < rows && !accumulate)
                STORE_GRADIENT(gradients + row * gradient_stride, (lane)0);
        return;
    }
    prefetch_rows(parameters, stride, i, rows);
    prefetch_slots(pair_sums, slot_start + (i + LANES < count ? i + LANES : i));
    lane sums[PAIR_SIZE];
    sum_pairs(sums, pair_sums, slot_start, slot_count, i);
    /* Sums are exactly zero for untouched Gaussians; selecting by them keeps undefined values below from
     * reaching a gradient (0 times infinity is not 0). */
    const lane_mask visible = sums[PAIR_TOUCHED] > (lane)0;

    projected g;
    project_block(&g, parameters, stride, i, camera, modifiers, modified, activated);
    const lane inverse = 1 / g.determinant;
    const lane a = g.covariance_yy * inverse, b = -g.covariance_xy * inverse,
               c = g.covariance_xx * inverse;

    const lane d_mean_x = a * sums[PAIR_PX] + b * sums[PAIR_PY];
    const lane d_mean_y = b * sums[PAIR_PX] + c * sums[PAIR_PY];
    /* dL/d(covariance) = -Q dL/dQ Q with Q the inverse covariance; dL/dQ from the second moments. */
    const lane d_a = (real)-0.5 * sums[PAIR_PXX], d_b = -sums[PAIR_PXY],
               d_c = (real)-0.5 * sums[PAIR_PYY];
    lane d_xx = -(a * a * d_a + a * b * d_b + b * b * d_c);
    lane d_xy = -(2 * a * b * d_a + (a * c + b * b) * d_b + 2 * b * c * d_c);
    lane d_yy = -(b * b * d_a + b * c * d_b + c * c * d_c);
    const lane d_log_opacity = sums[PAIR_P]; /* because alpha = opacity e^p */
#ifdef COMPENSATED
    /* The opacity falls with the square root of the determinant after dilation. */
    d_xx -= (real)0.5 * d_log_opacity * a;
    d_xy -= d_log_opacity * b;
    d_yy -= (real)0.5 * d_log_opacity * c;
#endif

    lane d_camera[3], d_mean[3], d_scale[3], d_quaternion[4], d_color[3], d_u[9], d_view[3];
    const real fx = camera[CAMERA_FX], fy = camera[CAMERA_FY];
    const lane inverse_z = 1 / g.z;
    d_camera[0] = fx * inverse_z * d_mean_x;
    d_camera[1] = fy * inverse_z * d_mean_y;
    d_camera[2] = sums[PAIR_Z]
        - inverse_z * inverse_z * (fx * g.x * d_mean_x + fy * g.y * d_mean_y);
    covariance_backward(
        &g, d_xx, d_xy, d_yy, d_log_opacity, activated, camera, d_scale, d_quaternion, d_camera,
        d_u);
    __global const wide *w = camera + CAMERA_ROTATION;
    real r[9];
#pragma unroll
    for (int k = 0; k < 9; k++)
        r[k] = w[k];
#pragma unroll
    for (int k = 0; k < 3; k++)
        d_mean[k] = r[k] * d_camera[0] + r[3 + k] * d_camera[1] + r[6 + k] * d_camera[2];

    const lane_mask dark = LOAD_BYTES(clamped + i);
#pragma unroll
    for (int channel = 0; channel < 3; channel++) /* a clamped colour has no gradient */
        d_color[channel] = (dark & 1 << channel) == 0 ? sums[PAIR_RED + channel] : (lane)0;
    color_backward(
        parameters, gradients, gradient_stride, stride, i, camera, degree, d_color, visible,
        accumulate, detached, d_mean, d_view);
#ifdef POSED
    store_pose_sums(pose_sums, &g, parameters, stride, i, visible, d_camera, d_u, d_view);
#endif

#pragma unroll
    for (int k = 0; k < 3; k++) {
        put_unless(
            detached & BIT_MEANS, gradients + (ROW_MEAN + k) * gradient_stride,
            visible ? d_mean[k] : (lane)0, accumulate);
        put_unless(
            detached & BIT_LOG_SCALES, gradients + (ROW_SCALE + k) * gradient_stride,
            visible ? d_scale[k] : (lane)0, accumulate);
    }
#pragma unroll
    for (int k = 0; k < 4; k++)
        put_unless(
            detached & BIT_QUATERNIONS, gradients + (ROW_QUATERNION + k) * gradient_stride,
            visible ? d_quaternion[k] : (lane)0, accumulate);
    put_unless(
        detached & BIT_OPACITY_LOGITS, gradients + ROW_OPACITY * gradient_stride,
        visible ? d_log_opacity / g.opacity * g.opacity_slope : (lane)0, accumulate);
    if (collect) {
        const lane ndc_x = d_mean_x * (real)(camera[CAMERA_WIDTH] / 2);
        const lane ndc_y = d_mean_y * (real)(camera[CAMERA_HEIGHT] / 2);
        const lane norm = visible ? lane_sqrt(ndc_x * ndc_x + ndc_y * ndc_y) : (lane)0;
        add(statistics + i, norm);
        add(statistics + stride + i, visible ? (lane)1 : (lane)0);
    }
    if (collect == COLLECT_ABSOLUTE) {
        const lane pull_x = sums[PAIR_ABSOLUTE_X] * (real)(camera[CAMERA_WIDTH] / 2) / LOG2_E;
        const lane pull_y = sums[PAIR_ABSOLUTE_Y] * (real)(camera[CAMERA_HEIGHT] / 2) / LOG2_E;
        const lane norm = visible ? lane_sqrt(pull_x * pull_x + pull_y * pull_y) : (lane)0;
        add(statistics + 2 * stride + i, norm);
    }
}

#ifndef STEP
__kernel __attribute__((reqd_work_group_size(PROJECT_GROUP, 1, 1))) void project_backward(
    __global const real *parameters, __global const real *modifiers, __global const wide *camera,
    __global const uchar *clamped, __global const real *pair_sums, __global const uint *slot_start,
    __global const uint *slot_count, __global real *gradients, __global real *statistics,
    uint count, uint capacity, int degree, int activated, int modified, int accumulate, int collect,
    int detached, __global wide *pose_sums /* of kernels with POSED; others ignore it */)
{
    const size_t begin = get_global_id(0) * PROJECT_SPAN;
    for (size_t i = begin; i < begin + PROJECT_SPAN && i < count; i += LANES)
        backward_of_block(
            parameters, modifiers, camera, clamped, pair_sums, slot_start, slot_count,
            gradients + i, capacity, statistics, count, capacity, degree, activated, modified,
            accumulate, collect, detached, pose_sums, i);
}
#endif
