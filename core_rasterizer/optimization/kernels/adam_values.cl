/* The arithmetic of a step of Adam (Kingma & Ba 2015). Twin: torch.optim.Adam.
 *
 * Each of six groups of rows has a learning rate, divided by the first bias correction, and 1 / sqrt of the
 * second. */

#if LANES == 1 /* so that kernels with and without a step of Adam give the same bits */
#pragma OPENCL FP_CONTRACT OFF
#endif

#ifndef GRADIENT
#define GRADIENT __global real
#endif

/* layout.py generates the kernel arguments ADAM_RATES and their selection by group: ADAM_RATES_BY_GROUP declares
 * the arrays `rates` and `corrections`, which keep the selection out of the loop; a chain of ?: took a tenth
 * longer. */

#define BETA1 ((real)0.9)
#define BETA2 ((real)0.999)
/* 1 - beta, written out: in float, 1 - 0.999f is wrong in the fifth digit. */
#define SHARE1 ((real)0.1)
#define SHARE2 ((real)0.001)
#define EPSILON ((real)1e-15)
/* The square of a larger gradient overflows; such gradients, and undefined ones, count as 0. */
#define MAX_GRADIENT ((real)1e18)
/* First moments below the smallest normal number become 0. Without gradient they would stay subnormal, because
 * 0.9 times the smallest number rounds to itself, and arithmetic with subnormal numbers is slow. */
#if REAL_IS_DOUBLE
#define MIN_MOMENT DBL_MIN
#else
#define MIN_MOMENT FLT_MIN
#endif

/* With VISIBLE_ONLY, values without gradient are skipped, so their moments do not decay; used by
 * benchmarks. Whole blocks without gradient cost one read instead of seven accesses. */
#ifndef VISIBLE_ONLY
#define VISIBLE_ONLY 0
#endif
#define BLOCK (LANES == 1 ? 1 : 16)

/* Bring finite logits back to where the sigmoid has a slope; an infinite one stays, as an error. */
static inline void limit_logits(__global real *logits, size_t begin, size_t end)
{
    for (size_t at = begin; at < end; at++) {
        const real x = logits[at], limit = x > 0 ? MAX_LOGIT : -MAX_LOGIT;
        const int beyond = (fabs(x) > MAX_LOGIT) & (fabs(x) < INFINITY);
        logits[at] = beyond ? limit : x;
    }
}

/* Scalar code that the compiler vectorizes, including the square root, thanks to `restrict`. Returns
 * whether a parameter is not finite afterwards. */
static inline int step_values(
    __global real *restrict parameters, const GRADIENT *restrict gradients,
    __global real *restrict first_moments, __global real *restrict second_moments, size_t begin,
    size_t end, real rate, real correction)
{
    int undefined = 0;
    for (size_t at = begin; at < end; at++) {
        const real given = gradients[at];
        const int defined = (given > -MAX_GRADIENT) & (given < MAX_GRADIENT);
        const real gradient = defined ? given : 0;
        const real m = BETA1 * first_moments[at] + SHARE1 * gradient;
        const real v = BETA2 * second_moments[at] + SHARE2 * (gradient * gradient);
        const real kept_m = (m > -MIN_MOMENT) & (m < MIN_MOMENT) ? 0 : m;
        const int still = VISIBLE_ONLY & (given == 0);
        first_moments[at] = still ? first_moments[at] : kept_m;
        second_moments[at] = still ? second_moments[at] : v;
        const real change = rate * m / (SCALAR_SQRT(v) * correction + EPSILON);
        const real moved = parameters[at] - (still ? 0 : change);
        parameters[at] = moved;
        /* Comparisons with NaN are false. */
        undefined |= !((moved > -INFINITY) & (moved < INFINITY));
    }
    return undefined;
}
