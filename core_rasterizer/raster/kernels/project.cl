/* Forward, stage 1: cull, project, colour, and pack one record per Gaussian. */

/* Writes the lanes of a block one record after another; overwrites `field`. */
static inline void store_records(__global real *records, size_t i, lane *field)
{
#if LANES == 1
#pragma unroll
    for (int q = 0; q < QUADS; q++)
        ((__global quad *)records)[i * QUADS + q] = vload4(q, field);
#else
    transpose(field);
    transpose(field + LANES);
#pragma unroll
    for (int l = 0; l < LANES; l++) {
        STORE_GLOBAL(records + (i + l) * REC_SIZE, field[l]);
        STORE_GLOBAL(records + (i + l) * REC_SIZE + LANES, field[LANES + l]);
    }
#endif
}

static inline void shade(
    lane *color, __global const real *parameters, size_t capacity, size_t i,
    __global const wide *camera, int degree)
{
    __global const real *row = parameters + i;
    lane dx = LOAD_GLOBAL(row + ROW_MEAN * capacity) - (real)camera[CAMERA_CENTER];
    lane dy = LOAD_GLOBAL(row + (ROW_MEAN + 1) * capacity) - (real)camera[CAMERA_CENTER + 1];
    lane dz = LOAD_GLOBAL(row + (ROW_MEAN + 2) * capacity) - (real)camera[CAMERA_CENTER + 2];
    const lane scale = 1 / lane_sqrt(dx * dx + dy * dy + dz * dz);
    lane basis[16];
    sh_basis(basis, degree, dx * scale, dy * scale, dz * scale);
    fade_last_band(basis, degree, camera);
    lane sums[3] = {(lane)0.5, (lane)0.5, (lane)0.5};
    const int coefficients = (degree + 1) * (degree + 1);
#if LANES == 1
#pragma unroll
#endif
    for (int k = 0; k < UP_TO(coefficients, 16); k++) {
        if (k >= coefficients)
            continue;
#pragma unroll
        for (int c = 0; c < 3; c++)
            sums[c] += basis[k] * LOAD_GLOBAL(row + (ROW_SH + 3 * k + c) * capacity);
    }
#pragma unroll
    for (int c = 0; c < 3; c++)
        color[c] = sums[c];
}

static inline void project_and_pack(
    __global const real *parameters, __global const real *modifiers, __global const wide *camera,
    __global real *records, __global uint *keys, __global int *slot_count, __global uchar *clamped,
    __global uint4 *covers, uint count, uint capacity, int degree, int activated, int modified,
    size_t i)
{
#pragma unroll
    for (int l = 0; l < LANES; l++) {
        keys[i + l] = INVISIBLE;
        slot_count[i + l] = 0;
    }
    if (i >= count)
        return;

    prefetch_rows(parameters, capacity, i, ROW_SH + 3 * (degree + 1) * (degree + 1));
    projected g;
    project_block(&g, parameters, capacity, i, camera, modifiers, modified, activated);

    const lane inverse = 1 / g.determinant;
    const lane a = g.covariance_yy * inverse, b = -g.covariance_xy * inverse,
               c = g.covariance_xx * inverse;
    const lane mean_x = g.mean_x, mean_y = g.mean_y;

    /* alpha >= 1/255 inside the ellipse whose exponent is ln(1 / (255 o)): the opacity-aware extent. */
    const lane ratio = (real)ALPHA_CUT_INVERSE * g.opacity;
    const lane level = lane_log(ratio > (lane)1 ? LANE_MIN(ratio, (lane)REAL_LARGEST) : (lane)1);
    /* With a small margin, because the per-pixel test decides. */
    const lane reach_x = lane_sqrt(2 * level * g.covariance_xx) * (real)1.00001 + (real)1e-3;
    const lane reach_y = lane_sqrt(2 * level * g.covariance_yy) * (real)1.00001 + (real)1e-3;

    /* Comparisons are false for NaN, so each test also culls NaN. */
    const real big = REAL_LARGEST, width = camera[CAMERA_WIDTH], height = camera[CAMERA_HEIGHT];
    lane_mask visible = (g.z > (lane)(real)camera[CAMERA_NEAR]) & (g.z < (lane)big);
    visible &= (ratio >= (lane)1) & (ratio < (lane)big);
    visible &= (g.determinant < (lane)big) & (lane_abs(a) < (lane)big) & (lane_abs(c) < (lane)big);
    visible &= (mean_x + reach_x > (lane)0.5f) & (mean_x - reach_x < (lane)(width - 0.5f));
    visible &= (mean_y + reach_y > (lane)0.5f) & (mean_y - reach_y < (lane)(height - 0.5f));

    int any = 0;
#pragma unroll
    for (int l = 0; l < LANES; l++)
        any |= LANE_AT_MASK(visible, l) && i + l < count;
    if (!any)
        return;

    lane field[REC_SIZE], color[3];
    shade(color, parameters, capacity, i, camera, degree);
#pragma unroll
    for (int channel = 0; channel < 3; channel++) {
        visible &= lane_abs(color[channel]) < (lane)big;
        color[channel] = LANE_MAX(color[channel], (lane)0);
    }
    lane_mask dark = (lane_mask)0;
#pragma unroll
    for (int channel = 0; channel < 3; channel++)
        dark |= color[channel] <= (lane)0 ? (lane_mask)(1 << channel) : (lane_mask)0;
#pragma unroll
    for (int l = 0; l < LANES; l++)
        clamped[i + l] = LANE_AT_MASK(dark, l);

    field[REC_X] = mean_x;
    field[REC_Y] = mean_y;
    field[REC_A] = (real)-0.5 * LOG2_E * a;
    field[REC_B] = -LOG2_E * b;
    field[REC_C] = (real)-0.5 * LOG2_E * c;
    field[REC_OPACITY] = g.opacity;
    field[REC_RED] = color[0];
    field[REC_GREEN] = color[1];
    field[REC_BLUE] = color[2];
    field[REC_Z] = g.z;
    field[REC_X0] = LANE_MAX(mean_x - reach_x + (real)0.5, (lane)0);
    field[REC_X1] = LANE_MIN(mean_x + reach_x + (real)0.5, (lane)width);
    field[REC_Y0] = LANE_MAX(mean_y - reach_y + (real)0.5, (lane)0);
    field[REC_Y1] = LANE_MIN(mean_y + reach_y + (real)0.5, (lane)height);
    field[REC_REST_X] = g.rest_x;
    field[REC_REST_Y] = g.rest_y;
    const tile_boxes boxes = tiles_of_block(field);
    store_records(records, i, field);
    lane floor_of_alpha = -level * LOG2_E; /* the exponent of 2 at which alpha is the cut-off */
#pragma unroll
    for (int l = 0; l < LANES; l++)
        if (LANE_AT_MASK(visible, l) && i + l < count) {
            const uint4 cover = cover_of(
                boxes, l, records + (i + l) * REC_SIZE, LANE_AT(floor_of_alpha, l));
            covers[i + l] = cover;
            if (cover.z | cover.w)
                /* Positive floats sort as integers. */
                keys[i + l] = as_uint((float)LANE_AT(g.z, l));
        }
}

__kernel __attribute__((reqd_work_group_size(PROJECT_GROUP, 1, 1))) void project(
    __global const real *parameters, __global const real *modifiers, __global const wide *camera,
    __global real *records, __global uint *keys, __global int *slot_count, __global uchar *clamped,
    __global uint4 *covers, uint count, uint capacity, int degree, int activated, int modified)
{
    const size_t begin = get_global_id(0) * PROJECT_SPAN;
    for (size_t i = begin; i < begin + PROJECT_SPAN && i < capacity; i += LANES)
        project_and_pack(
            parameters, modifiers, camera, records, keys, slot_count, clamped, covers, count,
            capacity, degree, activated, modified, i);
}
