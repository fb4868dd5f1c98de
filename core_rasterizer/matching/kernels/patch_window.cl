/* The window around a pixel of the reference image.
 *
 * A lane is a pixel: LANES pixels of one row, equally spaced. Windows use every second pixel, like the
 * squares of one colour of a chessboard.
 */

#define SIDE (2 * RADIUS + 1)
#define SAMPLES ((SIDE * SIDE + 1) / 2)
#define FIRST_IN_ROW(v) (((v) + RADIUS) % 2 - RADIUS)
#define COLOR_FALLOFF 3.125f /* 1 / (2 * 0.4^2), for grey values in [-1, 1] */

/* A pixel's window in the reference image: weights of sum 1, weights times (grey value - mean), and the
 * variance. */
typedef struct {
    lane x, y; /* of the pixel's centre */
    lane weights[SAMPLES], centered[SAMPLES];
    lane variance;
} window;

static inline lane gather_real(__global const real *table, lane_int at)
{
#if LANES == 1
    return table[at];
#else
    return (lane)(table[at.s0], table[at.s1], table[at.s2], table[at.s3], table[at.s4],
                  table[at.s5], table[at.s6], table[at.s7]);
#endif
}

static inline lane_int limited(lane_int value, int last)
{
    value = value < 0 ? (lane_int)0 : value;
    return value > last ? (lane_int)last : value;
}

static inline bool in_any_lane(lane_int mask)
{
    int found = 0;
    for (int i = 0; i < LANES; i++)
        found |= LANE_AT_INT(mask, i);
    return found != 0;
}

/* Columns of neighbouring lanes, `step` apart; those beyond the row repeat the first lane. */
static inline lane_int columns(int first, int step, int width)
{
    lane_int x;
    for (int i = 0; i < LANES; i++)
        ((int *)&x)[i] = first + i * step < width ? first + i * step : first;
    return x;
}

/* Weights fall with the distance and with the difference in grey, so that a window stays on one
 * surface (Schoenberger et al., ECCV 2016). */
static inline void look_around(
    __global const real *grey, int width, int height, lane_int x, int y, window *here)
{
    const lane middle = gather_real(grey, y * width + x);
    lane values[SAMPLES], total = (lane)0, mean = (lane)0;
    here->x = FROM_INT(x) + 0.5f;
    here->y = (lane)(y + 0.5f);
    for (int i = 0, v = -RADIUS; v <= RADIUS; v++) {
        const int row = clamp(y + v, 0, height - 1);
        const lane_int row_within = (lane_int)(row == y + v ? -1 : 0);
        for (int u = FIRST_IN_ROW(v); u <= RADIUS; u += 2, i++) {
            const lane_int column = x + u;
            const lane_int within = (column >= 0) & (column < width) & row_within;
            values[i] = gather_real(grey, row * width + limited(column, width - 1));
            const lane off = values[i] - middle;
            const real distance = (real)(u * u + v * v) / (2 * RADIUS * RADIUS);
            const lane weight = lane_exp(-off * off * COLOR_FALLOFF - distance);
            here->weights[i] = within ? weight : (lane)0;
            total += here->weights[i];
            mean += here->weights[i] * values[i];
        }
    }
    mean /= total;
    here->variance = (lane)0;
    for (int i = 0; i < SAMPLES; i++) {
        here->weights[i] /= total;
        here->centered[i] = here->weights[i] * (values[i] - mean);
        here->variance += here->centered[i] * (values[i] - mean);
    }
}
