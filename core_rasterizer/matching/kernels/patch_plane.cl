/* Planes in space, and random planes.
 *
 * The inverse depth w of a plane is linear in the reference image, so it is stored as w at the pixel's
 * centre and its steps to the right and down. `planes` is four images: w, step right, step down, cost.
 */

#if LANES == 1
typedef uint lane_uint;
#define AS_INT(x) ((int)(x))
#else
typedef GLUE(uint, LANES) lane_uint;
#define AS_INT(x) (*(const lane_int *)&(x))
#endif

typedef struct {
    lane nearness, right, down; /* inverse depth, and its steps to the neighbours */
} plane;

static inline plane load_plane(__global const real *planes, int pixels, lane_int at)
{
    plane p;
    p.nearness = gather_real(planes, at);
    p.right = gather_real(planes + pixels, at);
    p.down = gather_real(planes + 2 * pixels, at);
    return p;
}

static inline plane either(lane_int first, plane a, plane b)
{
    plane p;
    p.nearness = first ? a.nearness : b.nearness;
    p.right = first ? a.right : b.right;
    p.down = first ? a.down : b.down;
    return p;
}

/* A hash of 32 bits: each bit of the input changes each bit of the output half of the time. */
static inline lane_uint mixed(lane_uint x)
{
    x ^= x >> 16;
    x *= (lane_uint)0x7feb352du;
    x ^= x >> 15;
    x *= (lane_uint)0x846ca68bu;
    return x ^ (x >> 16);
}

/* A number in [0, 1) that depends only on the pixel, the launch's key and the number of the draw. */
static inline lane uniform_draw(lane_int pixel, uint key, uint draw)
{
    const lane_uint x = mixed(mixed((*(const lane_uint *)&pixel) + key) + draw) >> 8;
    return FROM_INT(AS_INT(x)) * (1.0f / 16777216);
}

/* A plane through the same point with its normal moved by up to `amount` of its length in each direction
 * of the camera's axes; the old one where it would be seen at less than six degrees. A plane's normal is
 * (fx right, fy down, w - the rest at the principal point); along the pixel's ray it has the length w. */
static inline plane tilted(
    plane p, lane amount, lane_int pixel, uint key, uint draw, lane ray_x, lane ray_y, real focal_x,
    real focal_y)
{
    lane nx = focal_x * p.right, ny = focal_y * p.down;
    lane nz = p.nearness - nx * ray_x - ny * ray_y;
    const lane length = amount * lane_sqrt(nx * nx + ny * ny + nz * nz);
    nx += length * (2 * uniform_draw(pixel, key, draw) - 1);
    ny += length * (2 * uniform_draw(pixel, key, draw + 1) - 1);
    nz += length * (2 * uniform_draw(pixel, key, draw + 2) - 1);
    const lane along = nx * ray_x + ny * ray_y + nz;
    const lane squared = (nx * nx + ny * ny + nz * nz) * (ray_x * ray_x + ray_y * ray_y + 1);
    plane q = p;
    q.right = p.nearness * nx / (along * focal_x);
    q.down = p.nearness * ny / (along * focal_y);
    return either((along > (lane)0) & (along * along > 0.01f * squared), q, p);
}

/* Random planes, facing the camera at any angle. */
__kernel void draw_planes(
    __global real *planes, int width, int height, real farthest, real nearest, real focal_x,
    real focal_y, real center_x, real center_y, uint key)
{
    const int y = get_global_id(1), pixels = width * height;
    const int first = get_global_id(0) * LANES;
    const lane_int x = columns(first, 1, width);
    const lane_int at = y * width + x;
    const lane ray_x = (FROM_INT(x) + 0.5f - center_x) / focal_x;
    const lane ray_y = (lane)((y + 0.5f - center_y) / focal_y);
    plane p;
    p.nearness = farthest + (nearest - farthest) * uniform_draw(at, key, 0);
    p.right = p.down = (lane)0;
    p = tilted(p, (lane)1, at, key, 1, ray_x, ray_y, focal_x, focal_y);
    for (int i = 0; i < LANES && first + i < width; i++) {
        __global real *to = planes + y * width + first + i;
        to[0] = LANE_AT(p.nearness, i);
        to[pixels] = LANE_AT(p.right, i);
        to[2 * pixels] = LANE_AT(p.down, i);
    }
}
