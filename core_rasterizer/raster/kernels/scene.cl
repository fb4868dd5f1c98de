/* Shared by the stages. The places of numbers in the camera (CAMERA_), in a Gaussian's record (REC_), in the sums
 * of a pair (PAIR_), in the pose's gradient (POSE_) and among the counters (COUNT_) come from layout.py. */

/* GPUs move records and sums in quads, with a quarter of the instructions. */
typedef GLUE(REAL_NAME, 4) quad;
#define QUADS (REC_SIZE / 4)

/* The last number of a pair's sums that kernels write. */
#ifdef ABSOLUTE
#define PAIR_LAST PAIR_ABSOLUTE_Y
#else
#define PAIR_LAST PAIR_TOUCHED
#endif

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
