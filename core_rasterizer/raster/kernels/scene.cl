/* Data shared by the stages: camera, record, sums of pairs. The rows of the parameter array (ROW_MEAN, ...)
 * come from layout.py. */

/* The camera block, in `wide`, written by the host for each render. */
#define CAMERA_ROTATION 0 /* 9: world to camera, row-major */
#define CAMERA_TRANSLATION 9
#define CAMERA_CENTER 12
#define CAMERA_FX 15
#define CAMERA_FY 16
#define CAMERA_CX 17
#define CAMERA_CY 18
#define CAMERA_LIMITS 19 /* x low, x high, y low, y high of the clamped ratios x/z and y/z */
#define CAMERA_WIDTH 23
#define CAMERA_HEIGHT 24
#define CAMERA_NEAR 25
#define CAMERA_BACKGROUND 26
#define CAMERA_LAST_BAND 29 /* the weight of the last SH band, where it is a fraction */
#define CAMERA_REST 32 /* the rounding errors of all these numbers; only with NO_DOUBLE */

/* GPUs move records and sums in quads, with a quarter of the instructions. */
typedef GLUE(REAL_NAME, 4) quad;

/* One record per Gaussian for the raster stages, 16 reals: a cache line in float. */
#define RECORD 16
#define QUADS (RECORD / 4)
#define REC_X 0
#define REC_Y 1
#define REC_A 2 /* exponent of 2: A dx^2 + B dx dy + C dy^2 */
#define REC_B 3
#define REC_C 4
#define REC_OPACITY 5
#define REC_RED 6
#define REC_GREEN 7
#define REC_BLUE 8
#define REC_Z 9
#define REC_REST_X 10 /* rounding errors of REC_X and REC_Y: the mean is their sum */
#define REC_REST_Y 11
#define REC_X0 12 /* the pixels it can reach: columns [x0, x1), rows [y0, y1) */
#define REC_X1 13
#define REC_Y0 14
#define REC_Y1 15

/* Sums over the pixels of a (tile, Gaussian) pair, 16 reals. */
#define PAIR 16
#define PAIR_P 0 /* sum of dL/d(exponent), then its moments about the mean */
#define PAIR_PX 1
#define PAIR_PY 2
#define PAIR_PXX 3
#define PAIR_PXY 4
#define PAIR_PYY 5
#define PAIR_RED 6
#define PAIR_GREEN 7
#define PAIR_BLUE 8
#define PAIR_Z 9
#define PAIR_TOUCHED 10 /* positive if any pixel was touched */
#define PAIR_ABSOLUTE_X 11 /* sums of absolute gradients of the mean, times log2(e); only with ABSOLUTE */
#define PAIR_ABSOLUTE_Y 12
#ifdef ABSOLUTE
#define PAIR_LAST PAIR_ABSOLUTE_Y
#else
#define PAIR_LAST PAIR_TOUCHED
#endif

/* Part of a block of Gaussians in the gradient of the pose, 16 of `wide`. */
#define POSE 16
#define POSE_ROTATION 0 /* 9, row-major */
#define POSE_TRANSLATION 9
#define POSE_VIEW 12 /* 3: the sum of dL/d(mean - camera centre) along the view directions of colours */

/* The counters block: unsigned 64-bit numbers. */
#define COUNT_VISIBLE 0
#define COUNT_PAIRS 1
#define COUNT_LAST 3

/* Thresholds of blending; benchmarks build with other values. */
#ifndef ALPHA_CUT_INVERSE
#define ALPHA_CUT_INVERSE 255
#endif
#ifndef EARLY_STOP
#define EARLY_STOP 1e-4
#endif

#define ALPHA_CUT ((real)(1.0 / ALPHA_CUT_INVERSE))
#define ALPHA_MAX ((real)0.99)
#define TRANSMITTANCE_STOP ((real)EARLY_STOP)
#define LOG2_E ((real)1.4426950408889634)
#define MIN_QUATERNION ((real)1e-12)
#define INVISIBLE 0xFFFFFFFFu
