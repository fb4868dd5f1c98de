/* Images as pairs of pixels (pack_pairs in sweep_images.cl): a value in the low half of a number, and the
 * step to its right neighbour in the high half. One load serves two corners of an interpolation. */

static inline lane_int gather(__global const int *table, lane_int at)
{
#if LANES == 1
    return table[at];
#elif LANES == 8
    return (lane_int)(table[at.s0], table[at.s1], table[at.s2], table[at.s3], table[at.s4],
                      table[at.s5], table[at.s6], table[at.s7]);
#else
    return (lane_int)(table[at.s0], table[at.s1], table[at.s2], table[at.s3], table[at.s4],
                      table[at.s5], table[at.s6], table[at.s7], table[at.s8], table[at.s9],
                      table[at.sa], table[at.sb], table[at.sc], table[at.sd], table[at.se],
                      table[at.sf]);
#endif
}

/* Bilinear interpolation; (0, 0) is the centre of the first pixel, and positions are clamped to the border.
 * The order of comparisons turns NaN into 0. */
static inline lane between_pixels(__global const int *pairs, int width, int height, lane u, lane v)
{
    u = LANE_MAX(u, (lane)0);
    v = LANE_MAX(v, (lane)0);
    u = LANE_MIN(u, (lane)(width - 1));
    v = LANE_MIN(v, (lane)(height - 1));
    const lane_int left = TO_INT(u), top = TO_INT(v);
    const lane_int at = top * width + left;
    const lane_int above = gather(pairs, at), below = gather(pairs + width, at);
    const lane part = u - FROM_INT(left);
    const lane upper = FROM_INT((above << 16) >> 16) + part * FROM_INT(above >> 16);
    const lane lower = FROM_INT((below << 16) >> 16) + part * FROM_INT(below >> 16);
    return upper + (v - FROM_INT(top)) * (lower - upper);
}
