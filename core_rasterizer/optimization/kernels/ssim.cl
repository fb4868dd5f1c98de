/* SSIM at one pixel, its derivatives, and the gradient of L1 + D-SSIM. Twin:
 * tests/core_rasterizer/test_photometric.py.
 *
 * Everything is expressed in differences x - y, with e = mu_x - mu_y and v = the variance of x - y:
 *   1 - SSIM = e^2 / d1 + (n1 / d1) (v / d2),  d1 = n1 + e^2,  d2 = n2 + v,
 *   n1 = 2 mu_x mu_y + C1,  n2 = 2 cov(x, y) + C2.
 * This equals the usual formula, but does not cancel as x approaches y: for equal images the loss and its
 * gradient are exactly 0. */

/* CHANNELS, RADIUS, MAPS, DERIVATIVES and ROWS come from photometric.py. */
#define TAPS (2 * RADIUS + 1)
#define C1 ((real)0.0001)
#define C2 ((real)0.0009)

/* exp(-k^2 / (2 * 1.5^2)) for k = -5 .. 5, divided by their sum. */
__constant real window[TAPS] = {
    (real)0.00102838008447911, (real)0.00759875813523919, (real)0.0360007721284308,
    (real)0.109360689509700,   (real)0.213005537711254,   (real)0.266011724861794,
    (real)0.213005537711254,   (real)0.109360689509700,   (real)0.0360007721284308,
    (real)0.00759875813523919, (real)0.00102838008447911};

/* 1 - SSIM from the windows of x, x - y, (x - y)^2 and x y, and the derivatives of SSIM by the windows of x,
 * (x - y)^2 and x y, with those of y held. */
static inline lane dissimilarity_of(
    lane mean, lane e, lane square, lane product, lane *by_mean, lane *by_square, lane *by_product)
{
    const lane means = mean * (mean - e), ee = e * e;
    const lane n1 = 2 * means + C1, n2 = 2 * (product - means) + C2;
    const lane v = square - ee;
    const lane d1 = n1 + ee, d2 = n2 + v;
    const lane inverse1 = 1 / d1, inverse2 = 1 / d2;
    const lane lost = ee * inverse1 + n1 * inverse1 * v * inverse2;
    *by_mean = 2 * inverse1 * inverse2
        * ((n2 - n1) * (lost * mean - e) - (1 - lost) * mean * (v - ee));
    *by_square = (lost - 1) * inverse2;
    *by_product = 2 * n1 * inverse1 * v * inverse2 * inverse2;
    return lost;
}

/* The gradient at a pixel, from the windows of the three derivatives, d = x - y and y. */
static inline lane slope_of(
    lane by_mean, lane by_square, lane by_product, lane d, lane y, real l1_scale, real ssim_scale)
{
    const lane sign = d > (lane)0 ? (lane)1 : d < (lane)0 ? (lane)-1 : (lane)0;
    const lane slope = l1_scale * sign
        - ssim_scale * (by_mean + 2 * d * by_square + y * by_product);
    /* Values above 1e12 may overflow; undefined gradients become 0. */
    return lane_abs(slope) < (lane)REAL_LARGEST ? slope : (lane)0;
}
