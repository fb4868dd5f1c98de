/* The projection of one block of Gaussians, shared by the forward and the backward pass.
 *
 * Macros: VARIANCE_ADDED, square pixels, is added to the variances on the image; COMPENSATED and SMOOTHED
 * here, FADED and POSED elsewhere, enable options, which cost nothing otherwise. */

#if LANES == 1 /* so that kernels with and without a step of Adam give the same bits */
#pragma OPENCL FP_CONTRACT OFF
#endif

#define DILATION ((real)VARIANCE_ADDED)

typedef struct {
    lane x, y, z; /* mean in camera coordinates */
    lane mean_x, mean_y; /* mean on the image, pixels */
    lane rest_x, rest_y; /* rounding errors of mean_x and mean_y */
    lane ratio_x, ratio_y; /* x/z and y/z after the clamp */
    lane_mask free_x, free_y; /* where the clamp is inactive */
    lane j00, j02, j11, j12; /* Jacobian of the projection */
    lane u[9]; /* camera-from-Gaussian rotation, row-major */
    lane scale[3];
    lane a0[3], a1[3]; /* rows of J W R S; their Gram matrix is the 2D covariance */
#ifdef COMPENSATED
    lane cross[3]; /* a0 x a1; its square is the determinant before dilation */
#endif
#ifdef SMOOTHED
    lane shrinkage[3]; /* scale before smoothing over scale after it */
    lane share[3]; /* share of smoothing in the variance, from 0 to 1 */
#endif
    lane qw, qx, qy, qz; /* unit quaternion */
    lane inverse_norm; /* 1 / |q|, 0 where q was zero */
    lane covariance_xx, covariance_xy, covariance_yy;
    lane determinant;
    lane opacity; /* activated, modifier included */
    lane opacity_slope; /* d opacity / d parameter */
} projected;

#define ROWS_AHEAD 64 /* Gaussians */

/* Sixty rows are more streams than hardware prefetches. Addresses beyond a row's end are harmless. */
static inline void prefetch_rows(__global const real *rows, size_t capacity, size_t i, int count)
{
    if (LANES > 1 && i % 16 == 0) /* a cache line */
        for (int row = 0; row < count; row++)
            PREFETCH(rows + row * capacity + i + ROWS_AHEAD);
}

/* Opacity and its slope: the parameter is a logit, or the opacity itself where `activated`. */
static inline void read_opacity(projected *g, lane parameter, lane modifier, int activated)
{
    if (activated) {
        g->opacity = parameter * modifier;
        g->opacity_slope = modifier;
        return;
    }
    /* Both sigmoid(x) and 1 - sigmoid(x) without cancellation. */
    const lane decay = lane_exp(-lane_abs(parameter));
    const lane near_one = 1 / (1 + decay), near_zero = decay / (1 + decay);
    g->opacity = (parameter > (lane)0 ? near_one : near_zero) * modifier;
    g->opacity_slope = near_one * near_zero * modifier;
}

/* The matrix of a unit quaternion, row-major. */
static inline void rotation_of(lane w, lane x, lane y, lane z, lane *rotation)
{
    rotation[0] = 1 - 2 * (y * y + z * z);
    rotation[1] = 2 * (x * y - w * z);
    rotation[2] = 2 * (x * z + w * y);
    rotation[3] = 2 * (x * y + w * z);
    rotation[4] = 1 - 2 * (x * x + z * z);
    rotation[5] = 2 * (y * z - w * x);
    rotation[6] = 2 * (x * z - w * y);
    rotation[7] = 2 * (y * z + w * x);
    rotation[8] = 1 - 2 * (x * x + y * y);
}

static inline void read_rotation(projected *g, lane w, lane x, lane y, lane z, lane *rotation)
{
    lane largest = LANE_MAX(LANE_MAX(lane_abs(w), lane_abs(x)), LANE_MAX(lane_abs(y), lane_abs(z)));
    const lane_mask zero = largest < (lane)MIN_QUATERNION;
    largest = zero ? (lane)1 : largest;
    w /= largest, x /= largest, y /= largest, z /= largest;
    w = zero ? (lane)1 : w;
    x = zero ? (lane)0 : x;
    y = zero ? (lane)0 : y;
    z = zero ? (lane)0 : z;
    const lane scale = 1 / lane_sqrt(w * w + x * x + y * y + z * z);
    g->inverse_norm = zero ? (lane)0 : scale / largest;
    w *= scale, x *= scale, y *= scale, z *= scale;
    g->qw = w, g->qx = x, g->qy = y, g->qz = z;
    rotation_of(w, x, y, z, rotation);
}

#ifdef SMOOTHED
/* Convolution with a Gaussian of standard deviation f, Mip-Splatting's 3D filter (Yu et al. 2024, eq. 9):
 * variances add up. Computed from the quotient, so that squares neither overflow nor underflow. */
static inline void widen(projected *g, int k, lane f)
{
    const lane s = g->scale[k];
    const lane larger = LANE_MAX(s, f), quotient = LANE_MIN(s, f) / larger;
    const lane widened = larger * lane_sqrt(1 + quotient * quotient), given = f / widened;
    const lane_mask filtered = f > (lane)0;
    g->shrinkage[k] = filtered ? s / widened : (lane)1;
    g->share[k] = filtered ? given * given : (lane)0;
    g->scale[k] = filtered ? widened : s;
}
#endif

/* Apply both filters to the opacity. */
static inline void filter_opacity(projected *g)
{
#ifdef SMOOTHED
    const lane kept = g->shrinkage[0] * g->shrinkage[1] * g->shrinkage[2];
    g->opacity *= kept;
    g->opacity_slope *= kept;
#endif
#ifdef COMPENSATED
    /* Mip-Splatting's 2D filter (eq. 10): dilation preserves the Gaussian's mass. */
    const lane undilated = g->cross[0] * g->cross[0] + g->cross[1] * g->cross[1]
        + g->cross[2] * g->cross[2];
    const lane compensation = lane_sqrt(undilated / g->determinant);
    g->opacity *= compensation;
    g->opacity_slope *= compensation;
#endif
}

#ifdef NO_DOUBLE
/* An unevaluated sum of two floats, about 36 bits. Products are split into exact parts, so the results do not
 * depend on whether the compiler contracts multiplications and additions. */
typedef struct {
    lane high, low;
} pair;

/* The 12 leading bits; the rest has 12 bits too, so products of two parts are exact. */
static inline lane leading_bits(lane x)
{
    const lane_mask bits = *(const lane_mask *)&x & (lane_mask)0xFFFFF000;
    return *(const lane *)&bits;
}

/* Knuth's exact sum of two floats, and the rest of the terms. */
static inline pair add_float(pair sum, lane x)
{
    const lane total = sum.high + x, added = total - sum.high;
    const pair result = {total, sum.low + ((sum.high - (total - added)) + (x - added))};
    return result;
}

/* sum + (a + rest_of_a) * b */
static inline pair add_product(pair sum, lane a, lane rest_of_a, lane b)
{
    const lane a_high = leading_bits(a), b_high = leading_bits(b);
    const lane a_low = a - a_high, b_low = b - b_high;
    pair result = add_float(sum, a_high * b_high);
    result.low += a_high * b_low + a_low * b_high + a_low * b_low + rest_of_a * b;
    return result;
}

static inline pair rounded(pair sum)
{
    const lane total = sum.high + sum.low;
    const pair result = {total, sum.low - (total - sum.high)};
    return result;
}

static inline pair camera_number(__global const wide *camera, int index)
{
    const pair number = {(lane)camera[index], (lane)camera[CAMERA_SIZE + index]};
    return number;
}

/* One camera coordinate of a mean: its row of the rotation, and its translation. */
static inline pair camera_coordinate(__global const wide *camera, int axis, const lane *mean)
{
    pair sum = camera_number(camera, CAMERA_TRANSLATION + axis);
#pragma unroll
    for (int k = 0; k < 3; k++) {
        const pair factor = camera_number(camera, CAMERA_ROTATION + 3 * axis + k);
        sum = add_product(sum, factor.high, factor.low, mean[k]);
    }
    return rounded(sum);
}

/* focal * x / z + centre: the quotient is corrected by its remainder. */
static inline pair image_coordinate(pair x, pair z, pair focal, pair center)
{
    const lane quotient = x.high / z.high;
    const pair remainder = add_product(x, -z.high, -z.low, quotient);
    const lane rest = (remainder.high + remainder.low) / z.high;
    pair sum = add_product(center, focal.high, focal.low, quotient);
    sum.low += focal.high * rest;
    return rounded(sum);
}

static inline void project_mean(
    projected *g, lane mx, lane my, lane mz, __global const wide *camera)
{
    const lane mean[3] = {mx, my, mz};
    const pair x = camera_coordinate(camera, 0, mean), y = camera_coordinate(camera, 1, mean),
               z = camera_coordinate(camera, 2, mean);
    const pair image_x = image_coordinate(
        x, z, camera_number(camera, CAMERA_FX), camera_number(camera, CAMERA_CX));
    const pair image_y = image_coordinate(
        y, z, camera_number(camera, CAMERA_FY), camera_number(camera, CAMERA_CY));
    g->x = x.high, g->y = y.high, g->z = z.high;
    g->mean_x = image_x.high, g->mean_y = image_y.high;
    g->rest_x = image_x.low, g->rest_y = image_y.low;
}
#else
static inline void project_mean(
    projected *g, lane mx, lane my, lane mz, __global const wide *camera)
{
    __global const wide *w = camera + CAMERA_ROTATION;
    const wide_lane wide_x = TO_WIDE(mx), wide_y = TO_WIDE(my), wide_z = TO_WIDE(mz);
    const wide_lane x = w[0] * wide_x + w[1] * wide_y + w[2] * wide_z + w[9];
    const wide_lane y = w[3] * wide_x + w[4] * wide_y + w[5] * wide_z + w[10];
    const wide_lane z = w[6] * wide_x + w[7] * wide_y + w[8] * wide_z + w[11];
    const wide_lane per_z = 1 / z;
    const wide_lane image_x = camera[CAMERA_FX] * (x * per_z) + camera[CAMERA_CX];
    const wide_lane image_y = camera[CAMERA_FY] * (y * per_z) + camera[CAMERA_CY];
    g->x = FROM_WIDE(x);
    g->y = FROM_WIDE(y);
    g->z = FROM_WIDE(z);
    g->mean_x = FROM_WIDE(image_x);
    g->mean_y = FROM_WIDE(image_y);
    g->rest_x = FROM_WIDE(image_x - TO_WIDE(g->mean_x));
    g->rest_y = FROM_WIDE(image_y - TO_WIDE(g->mean_y));
}
#endif

/* Twin: reference.py, `project`. Without culling; values behind the camera are meaningless. A call would keep all of
 * `g` in memory. */
__attribute__((always_inline)) static inline void project_block(
    projected *g, __global const real *parameters, size_t capacity, size_t i,
    __global const wide *camera, __global const real *modifiers, int modified, int activated)
{
    __global const real *row = parameters + i;
    const lane mx = LOAD_GLOBAL(row + ROW_MEAN * capacity),
               my = LOAD_GLOBAL(row + (ROW_MEAN + 1) * capacity),
               mz = LOAD_GLOBAL(row + (ROW_MEAN + 2) * capacity);
    __global const wide *w = camera + CAMERA_ROTATION;
    project_mean(g, mx, my, mz, camera);

    lane rotation[9];
    read_rotation(
        g, LOAD_GLOBAL(row + ROW_QUATERNION * capacity),
        LOAD_GLOBAL(row + (ROW_QUATERNION + 1) * capacity),
        LOAD_GLOBAL(row + (ROW_QUATERNION + 2) * capacity),
        LOAD_GLOBAL(row + (ROW_QUATERNION + 3) * capacity), rotation);
#pragma unroll
    for (int j = 0; j < 3; j++)
#pragma unroll
        for (int k = 0; k < 3; k++)
            g->u[3 * j + k] = (real)w[3 * j] * rotation[k] + (real)w[3 * j + 1] * rotation[3 + k]
                + (real)w[3 * j + 2] * rotation[6 + k];

    __global const wide *limits = camera + CAMERA_LIMITS;
    const lane inverse_z = 1 / g->z, raw_x = g->x * inverse_z, raw_y = g->y * inverse_z;
    g->ratio_x = LANE_MIN(LANE_MAX(raw_x, (lane)(real)limits[0]), (lane)(real)limits[1]);
    g->ratio_y = LANE_MIN(LANE_MAX(raw_y, (lane)(real)limits[2]), (lane)(real)limits[3]);
    g->free_x = g->ratio_x == raw_x;
    g->free_y = g->ratio_y == raw_y;
    g->j00 = (real)camera[CAMERA_FX] * inverse_z;
    g->j02 = -g->j00 * g->ratio_x;
    g->j11 = (real)camera[CAMERA_FY] * inverse_z;
    g->j12 = -g->j11 * g->ratio_y;

    lane xx = (lane)0, xy = (lane)0, yy = (lane)0;
#pragma unroll
    for (int k = 0; k < 3; k++) {
        const lane parameter = LOAD_GLOBAL(row + (ROW_SCALE + k) * capacity);
        g->scale[k] = activated ? parameter : lane_exp(parameter);
#ifdef SMOOTHED
        widen(g, k, LOAD_GLOBAL(modifiers + capacity + i));
#endif
        g->a0[k] = g->scale[k] * (g->j00 * g->u[k] + g->j02 * g->u[6 + k]);
        g->a1[k] = g->scale[k] * (g->j11 * g->u[3 + k] + g->j12 * g->u[6 + k]);
        xx += g->a0[k] * g->a0[k];
        xy += g->a0[k] * g->a1[k];
        yy += g->a1[k] * g->a1[k];
    }
    /* det(A A^T + d I) = |a0 x a1|^2 + d (|a0|^2 + |a1|^2) + d^2 does not cancel: a needle a
     * hundred thousand times longer than wide keeps a positive determinant. */
    const lane c0 = g->a0[1] * g->a1[2] - g->a0[2] * g->a1[1];
    const lane c1 = g->a0[2] * g->a1[0] - g->a0[0] * g->a1[2];
    const lane c2 = g->a0[0] * g->a1[1] - g->a0[1] * g->a1[0];
#ifdef COMPENSATED
    g->cross[0] = c0, g->cross[1] = c1, g->cross[2] = c2;
#endif
    g->determinant = c0 * c0 + c1 * c1 + c2 * c2 + DILATION * (xx + yy) + DILATION * DILATION;
    g->covariance_xx = xx + DILATION;
    g->covariance_xy = xy;
    g->covariance_yy = yy + DILATION;
    const lane modifier = modified ? LOAD_GLOBAL(modifiers + i) : (lane)1;
    read_opacity(g, LOAD_GLOBAL(row + ROW_OPACITY * capacity), modifier, activated);
    filter_opacity(g);
}
