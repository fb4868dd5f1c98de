/* Number types shared by every kernel.
 *
 * `real` is float in runs and double under test. `lane` is a vector of LANES reals on a CPU, where a
 * work-item owns LANES neighbouring elements, and a plain real on a GPU (LANES = 1). The same source
 * serves both: arithmetic, comparison and `mask ? a : b` mean the same for vectors and scalars.
 *
 * Builtins such as max, sqrt and any are avoided on vectors: one widespread CPU runtime calls them as
 * functions and spills every vector register around the call.
 */

/* LANES = 0, used by rasterizer and SSIM on a CPU: choose by register width. */
#if LANES == 0
#undef LANES
#ifdef __AVX512F__
#define LANES 16
#else
#define LANES 8
#endif
#endif

#define GLUE_(a, b) a##b
#define GLUE(a, b) GLUE_(a, b)

#if REAL_IS_DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double real;
typedef long real_bits;
#define REAL_NAME double
#define BITS_NAME long
#define REAL_LARGEST 1e300
#define SCALAR_SQRT(x) sqrt(x)
#else
typedef float real;
typedef int real_bits;
#define REAL_NAME float
#define BITS_NAME int
#define REAL_LARGEST 1e37f
#if LANES > 1
#define SCALAR_SQRT(x) __builtin_sqrtf(x)
#else
#define SCALAR_SQRT(x) sqrt(x)
#endif
#endif

#if LANES == 1
typedef real lane;
typedef int lane_mask;
typedef int lane_int;
#define LOAD(pointer) (*(pointer))
#define STORE(pointer, value) (*(pointer) = (value))
#define LANE_AT(value, index) (value)
#define LANE_AT_MASK(value, index) (value)
#define LANE_AT_INT(value, index) (value)
#define TO_INT(x) ((int)(x))
#define FROM_INT(x) ((real)(x))
#else
typedef GLUE(REAL_NAME, LANES) lane;
typedef GLUE(BITS_NAME, LANES) lane_mask;
typedef GLUE(int, LANES) lane_int;
/* Vectors at any address: vloadn and vstoren would be split in halves by some compilers. */
typedef lane lane_anywhere __attribute__((aligned(sizeof(real))));
#define LOAD(pointer) (*(const lane_anywhere *)(pointer))
#define LOAD_GLOBAL(pointer) (*(__global const lane_anywhere *)(pointer))
#define STORE_GLOBAL(pointer, value) (*(__global lane_anywhere *)(pointer) = (value))
#define STORE(pointer, value) (*(lane_anywhere *)(pointer) = (value))
#define LOAD_BYTES(pointer)                                                                        \
    __builtin_convertvector(*(__global const GLUE(uchar, LANES) *)(pointer), lane_mask)
#define LANE_AT(value, index) (((real *)&(value))[index])
#define LANE_AT_MASK(value, index) (((const real_bits *)&(value))[index])
#define LANE_AT_INT(value, index) (((const int *)&(value))[index])
#define TO_INT(x) __builtin_convertvector((x), lane_int)
#define FROM_INT(x) __builtin_convertvector((x), lane)
#endif
#if LANES == 1
#define LOAD_GLOBAL(pointer) (*(pointer))
#define STORE_GLOBAL(pointer, value) (*(pointer) = (value))
#define LOAD_BYTES(pointer) ((lane_mask)(*(pointer)))
#endif

/* The end of a loop over `count` of at most `most` elements of a private array. A GPU goes through all, unrolled,
 * and skips those from `count` on: an index known only at run time would move the array from registers to memory. */
#define UP_TO(count, most) (LANES == 1 ? (most) : (count))

/* Prefetch a cache line on a CPU, to read, to read LATER (into the second level of caches) or to write. Any
 * address is valid. Compilers that target SPIR-V do not know the compiler's builtin, and Mesa's exits the
 * process: they get OpenCL's function, which does nothing in PoCL. */
#if LANES > 1 && (defined(__x86_64__) || defined(__aarch64__))
#define PREFETCH(pointer) __builtin_prefetch((const void *)(size_t)(pointer))
#define PREFETCH_LATER(pointer) __builtin_prefetch((const void *)(size_t)(pointer), 0, 2)
#define PREFETCH_TO_WRITE(pointer) __builtin_prefetch((const void *)(size_t)(pointer), 1)
#else
#if LANES > 1
#define PREFETCH(pointer) prefetch((__global const real *)(pointer), 1)
#else
#define PREFETCH(pointer)
#endif
#define PREFETCH_LATER PREFETCH
#define PREFETCH_TO_WRITE PREFETCH
#endif

/* Positions on the image are computed in double where the device can: in float the transform to camera
 * coordinates alone would cost 1e-4 pixels, which shows in the image of a Gaussian one pixel wide. */
#if HAS_DOUBLE || REAL_IS_DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double wide;
#define WIDE_NAME double
#else
typedef real wide;
#define WIDE_NAME REAL_NAME
#define NO_DOUBLE /* projection.cl adds pairs of floats */
#endif
#if LANES == 1
typedef wide wide_lane;
#define TO_WIDE(x) ((wide)(x))
#define FROM_WIDE(x) ((real)(x))
#else
typedef GLUE(WIDE_NAME, LANES) wide_lane;
#define TO_WIDE(x) __builtin_convertvector((x), wide_lane)
#define FROM_WIDE(x) __builtin_convertvector((x), lane)
#endif

#define LANE_MIN(a, b) ((a) < (b) ? (a) : (b))
#define LANE_MAX(a, b) ((a) > (b) ? (a) : (b))

static inline lane lane_abs(lane x)
{
#if LANES == 1
    return x < 0 ? -x : x;
#else
    const lane_mask all_but_sign = ~((lane_mask)1 << (8 * (int)sizeof(real) - 1));
    const lane_mask bits = *(const lane_mask *)&x & all_but_sign;
    return *(const lane *)&bits;
#endif
}

#if LANES == 8
/* Rows become columns. Three times, row k and row k + 4 are merged element by element: in the 6 bits of
 * an element's row and column that is a rotation by one, and rotation by three swaps the two. */
static inline void transpose(lane *rows)
{
#pragma unroll
    for (int round = 0; round < 3; round++) {
        lane merged[8];
#pragma unroll
        for (int k = 0; k < 4; k++) {
            const lane a = rows[k], b = rows[k + 4];
            merged[2 * k] = (lane)(a.s0, b.s0, a.s1, b.s1, a.s2, b.s2, a.s3, b.s3);
            merged[2 * k + 1] = (lane)(a.s4, b.s4, a.s5, b.s5, a.s6, b.s6, a.s7, b.s7);
        }
#pragma unroll
        for (int k = 0; k < 8; k++)
            rows[k] = merged[k];
    }
}
#endif

static inline lane lane_sqrt(lane x)
{
#if defined(__AVX__) && LANES == 8 && !REAL_IS_DOUBLE
    return __builtin_ia32_sqrtps256(x);
#else
    for (int i = 0; i < LANES; i++)
        LANE_AT(x, i) = SCALAR_SQRT(LANE_AT(x, i));
    return x;
#endif
}

/* e^x, to about one unit in the last place; x is clamped so that the result stays finite. The order of
 * the clamps' arguments lets NaN through. */
static inline lane lane_exp(lane x)
{
#if REAL_IS_DOUBLE || LANES == 1
    x = LANE_MIN((lane)(REAL_IS_DOUBLE ? 700 : 88), x);
    for (int i = 0; i < LANES; i++)
        LANE_AT(x, i) = exp(LANE_AT(x, i));
    return x;
#else
    /* x = n ln 2 + r with |r| <= ln 2 / 2; ln 2 in two parts keeps r exact. Adding and subtracting
     * 1.5 * 2^23 rounds to the nearest integer without a call. */
    x = LANE_MIN((lane)88.0f, LANE_MAX((lane)-87.0f, x));
    const lane shifted = x * 1.44269504f + 12582912.0f;
    const lane n = shifted - 12582912.0f;
    const lane r = (x - n * 0.693145752f) - n * 1.42860677e-6f;
    lane p = (lane)(1.0f / 5040.0f);
    p = p * r + 1.0f / 720.0f;
    p = p * r + 1.0f / 120.0f;
    p = p * r + 1.0f / 24.0f;
    p = p * r + 1.0f / 6.0f;
    p = p * r + 0.5f;
    p = p * r + 1.0f;
    p = p * r + 1.0f;
    const lane_int power = (TO_INT(n) + 127) << 23;
    return p * (*(const lane *)&power);
#endif
}

/* ln x for positive normal x, absolute error 3e-7 in float: enough for extents, which have a margin. */
static inline lane lane_log(lane x)
{
#if REAL_IS_DOUBLE || LANES == 1
    for (int i = 0; i < LANES; i++)
        LANE_AT(x, i) = log(LANE_AT(x, i));
    return x;
#else
    /* x = 2^n m with m in [2/3, 4/3); ln m = 2 artanh(s), s = (m - 1) / (m + 1), |s| <= 1/5. */
    const lane_int bits = *(const lane_int *)&x;
    const lane_int n = (bits - 0x3F2AAAAB) >> 23;
    const lane_int mantissa = bits - (n << 23);
    const lane m = *(const lane *)&mantissa;
    const lane s = (m - 1) / (m + 1), q = s * s;
    const lane odd = 2 * s * (1 + q * (1.0f / 3 + q * (1.0f / 5 + q * (1.0f / 7))));
    return FROM_INT(n) * 0.693147181f + odd;
#endif
}
