/* Tiles that a Gaussian can touch, in 16 bytes, so that binning, which is random access, stays in cache. */

/* Tiles that the boxes of a block of Gaussians touch, half open. */
typedef struct {
    lane_int x0, x1, y0, y1;
    lane_mask simple; /* one tile that contains the mean: no test needed */
} tile_boxes;

static inline tile_boxes tiles_of_block(const lane *field)
{
    tile_boxes boxes;
    boxes.x0 = TO_INT(field[REC_X0]) / TILE_WIDTH;
    boxes.x1 = (TO_INT(field[REC_X1]) + (TILE_WIDTH - 1)) / TILE_WIDTH;
    boxes.y0 = TO_INT(field[REC_Y0]) / TILE_HEIGHT;
    boxes.y1 = (TO_INT(field[REC_Y1]) + (TILE_HEIGHT - 1)) / TILE_HEIGHT;
    const lane x = field[REC_X] - FROM_INT(boxes.x0 * TILE_WIDTH);
    const lane y = field[REC_Y] - FROM_INT(boxes.y0 * TILE_HEIGHT);
    boxes.simple = (FROM_INT(boxes.x1 - boxes.x0) == (lane)1)
        & (FROM_INT(boxes.y1 - boxes.y0) == (lane)1) & (x >= (lane)0.5f) & (y >= (lane)0.5f)
        & (x <= (lane)(TILE_WIDTH - 0.5f)) & (y <= (lane)(TILE_HEIGHT - 0.5f));
    return boxes;
}

/* If 0, Gaussians enter every tile that their box touches: the same image with more pairs. */
#ifndef EXACT_TILE_TEST
#define EXACT_TILE_TEST 1
#endif

/* Whether the ellipse of alpha >= 1/255 reaches a pixel centre of the tile. The exponent is a concave
 * quadratic with its maximum at the mean: if the mean is outside, the maximum over the tile is on an edge
 * that faces it. */
static inline int reaches(__global const real *record, real floor_of_alpha, int tile_x, int tile_y)
{
    const real low_x = tile_x * TILE_WIDTH + (real)0.5 - record[REC_X];
    const real low_y = tile_y * TILE_HEIGHT + (real)0.5 - record[REC_Y];
    const real high_x = low_x + (TILE_WIDTH - 1), high_y = low_y + (TILE_HEIGHT - 1);
    const int inside_x = low_x <= 0 && high_x >= 0, inside_y = low_y <= 0 && high_y >= 0;
    if (!EXACT_TILE_TEST || (inside_x && inside_y))
        return 1;
    const real a = record[REC_A], b = record[REC_B], c = record[REC_C];
    real best = -REAL_LARGEST;
    if (!inside_x) {
        const real x = low_x > 0 ? low_x : high_x;
        real y = (real)-0.5 * b * x / c;
        y = y < low_y ? low_y : (y > high_y ? high_y : y);
        best = a * x * x + (b * x + c * y) * y;
    }
    if (!inside_y) {
        const real y = low_y > 0 ? low_y : high_y;
        real x = (real)-0.5 * b * y / a;
        x = x < low_x ? low_x : (x > high_x ? high_x : x);
        const real value = a * x * x + (b * x + c * y) * y;
        best = best > value ? best : value;
    }
    /* With a small margin, because the per-pixel test decides; an undefined value (a or c of a needle
     * rounded to 0) keeps the pair. */
    return !(best < floor_of_alpha * (real)1.0001 - (real)1e-3);
}

/* (first tile x | y << 16, width | height << 16, 64 bits: which tiles of the box are reached, row by
 * row). A box of more than 64 tiles is tested again where it is walked. */
#define BOX_BITS 64

static inline uint4 cover_of(
    tile_boxes boxes, int l, __global const real *record, real floor_of_alpha)
{
    const int x0 = LANE_AT_INT(boxes.x0, l), x1 = LANE_AT_INT(boxes.x1, l);
    const int y0 = LANE_AT_INT(boxes.y0, l), y1 = LANE_AT_INT(boxes.y1, l);
    const int width = x1 - x0, height = y1 - y0;
    ulong mask = 0;
    if (LANE_AT_MASK(boxes.simple, l))
        mask = 1;
    else if (width > 0 && height > 0 && width * height <= BOX_BITS) {
        ulong bit = 1;
        for (int y = y0; y < y1; y++)
            for (int x = x0; x < x1; x++, bit <<= 1)
                if (reaches(record, floor_of_alpha, x, y))
                    mask |= bit;
    } else if (width > 0 && height > 0)
        mask = ~0ul;
    return (uint4)(x0 | y0 << 16, width | height << 16, (uint)mask, (uint)(mask >> 32));
}

/* Run BODY with `tile` set for every tile that the Gaussian reaches, row by row. */
#define FOR_EACH_TILE(cover, record, BODY)                                                         \
    {                                                                                              \
        const int x0 = cover.x & 0xFFFF, y0 = cover.x >> 16;                                       \
        const int width = cover.y & 0xFFFF, height = cover.y >> 16;                                \
        const int large = width * height > BOX_BITS;                                               \
        const real floor_of_alpha = large ? -log2((real)ALPHA_CUT_INVERSE * (record)[REC_OPACITY]) \
                                          : (real)0;                                               \
        ulong mask = cover.z | (ulong)cover.w << 32;                                               \
        for (int y = y0; y < y0 + height; y++)                                                     \
            for (int x = x0; x < x0 + width; x++) {                                                \
                if (large ? reaches(record, floor_of_alpha, x, y) : (int)(mask & 1)) {             \
                    const int tile = y * tiles_x + x;                                              \
                    BODY                                                                           \
                }                                                                                  \
                mask >>= 1;                                                                        \
            }                                                                                      \
    }
