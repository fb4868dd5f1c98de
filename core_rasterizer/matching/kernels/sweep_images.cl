/* Input images of a plane sweep. Grey values are whole numbers; see plane_sweep.cl. */

#pragma OPENCL FP_CONTRACT OFF

/* A grey value in the low half of a pair and the step to its right neighbour in the high half, so that
 * one load serves both corners of an interpolation. The row after the last repeats it. */
__kernel void pack_pairs(
    __global const real *grey, __global int *pairs, int width, int height, int start)
{
    const int x = get_global_id(0), y = get_global_id(1);
    __global const real *row = grey + (size_t)(y < height ? y : height - 1) * width;
    const int here = (int)row[x], right = (int)row[x + 1 < width ? x + 1 : x];
    pairs[start + (size_t)y * width + x] = ((right - here) << 16) | (here & 0xffff);
}

/* For the window around each pixel, cropped at the border: the value at its centre, the number of pixels n,
 * their sum, and n^2 times their variance. */
__kernel void describe_windows(
    __global const real *grey, __global float4 *windows, int width, int height)
{
    const int x = get_global_id(0), y = get_global_id(1);
    int count = 0;
    real sum = 0, squares = 0;
    for (int v = max(y - RADIUS, 0); v <= min(y + RADIUS, height - 1); v++)
        for (int u = max(x - RADIUS, 0); u <= min(x + RADIUS, width - 1); u++) {
            const real value = grey[(size_t)v * width + u];
            count++;
            sum += value;
            squares += value * value;
        }
    const size_t at = (size_t)y * width + x;
    windows[at] = (float4)(grey[at], count, sum, count * squares - sum * sum);
}
