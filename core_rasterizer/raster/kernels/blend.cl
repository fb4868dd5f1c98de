/* Blending of one Gaussian into one pixel or vector of pixels, shared by both raster variants and by the
 * forward and backward pass, so that they take the same decisions. */

/* Degree of the polynomial for 2^x: 3 to 5, or 0 for the built-in function. */
#ifndef EXP2_DEGREE
#define EXP2_DEGREE 5
#endif

/* 2^x for x <= 0. Float: a polynomial on [-1/2, 1/2] of least relative error: 1e-4 with degree 3, 3e-6
 * with 4, 2e-7 with 5, of which half is rounding. */
static inline lane power_of_two(lane x)
{
#if REAL_IS_DOUBLE || LANES == 1 || EXP2_DEGREE == 0
    for (int i = 0; i < LANES; i++)
        LANE_AT(x, i) = exp2(LANE_AT(x, i));
    return x;
#else
    x = LANE_MAX(x, (lane)-125.0f);
    const lane shifted = x + 12582912.0f; /* rounds to the nearest integer */
    const lane f = x - (shifted - 12582912.0f);
#if EXP2_DEGREE == 3
    lane p = (lane)5.50089319e-2f;
    p = p * f + 2.42210959e-1f;
    p = p * f + 6.93282927e-1f;
#elif EXP2_DEGREE == 4
    lane p = (lane)9.58285292e-3f;
    p = p * f + 5.59064248e-2f;
    p = p * f + 2.40240986e-1f;
    p = p * f + 6.93124193e-1f;
#else
    lane p = (lane)1.32647273e-3f;
    p = p * f + 9.67151299e-3f;
    p = p * f + 5.55073358e-2f;
    p = p * f + 2.40222424e-1f;
    p = p * f + 6.93147004e-1f;
#endif
    p = p * f + 1.0f;
    /* The integer sits in the low bits of `shifted`; moved to the exponent it multiplies by 2^n. */
    const lane_int bits = *(const lane_int *)&p + (*(const lane_int *)&shifted << 23);
    return *(const lane *)&bits;
#endif
}

typedef struct {
    lane raw; /* opacity times the Gaussian's value, unclamped */
    lane alpha; /* clamped at 0.99; 0 below the cut-off */
    lane weight; /* alpha times transmittance; 0 where nothing is added */
    lane next; /* transmittance behind the Gaussian; meaningful where `unfinished` */
    lane_mask unfinished; /* the pixel was not finished, and is not finished by this Gaussian */
} contribution;

/* `transmittance` is negative in finished pixels. A pixel finishes before the Gaussian that would lower its
 * transmittance to 1e-4 or below. */
static inline contribution contribution_at(lane exponent, real opacity, lane transmittance)
{
    contribution m;
    m.raw = opacity * power_of_two(LANE_MIN(exponent, (lane)0));
    m.alpha = LANE_MIN(m.raw, (lane)ALPHA_MAX);
    m.alpha = m.alpha >= (lane)ALPHA_CUT ? m.alpha : (lane)0;
    m.next = transmittance * (1 - m.alpha);
    m.unfinished = m.next > (lane)TRANSMITTANCE_STOP;
    m.weight = m.unfinished ? m.alpha * transmittance : (lane)0;
    return m;
}

/* The transmittance to keep: the new one, or the old one marked finished. */
static inline lane keep_transmittance(contribution m, lane transmittance)
{
    return m.unfinished ? m.next : -lane_abs(transmittance);
}
