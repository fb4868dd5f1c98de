/* Real spherical harmonics up to degree 3 in the order that 3DGS files use; basis and its gradient.
 * Twin: core_rasterizer/spherical_harmonics.py */

#define SH_C0 ((real)0.28209479177387814)
#define SH_C1 ((real)0.4886025119029199)
#define SH_C2A ((real)1.0925484305920792)
#define SH_C2B ((real)0.31539156525252005)
#define SH_C2C ((real)0.5462742152960396)
#define SH_C3A ((real)0.5900435899266435)
#define SH_C3B ((real)2.890611442640554)
#define SH_C3C ((real)0.4570457994644658)
#define SH_C3D ((real)0.3731763325901154)
#define SH_C3E ((real)1.445305721320277)

/* basis[k] for the unit direction (x, y, z); (degree + 1)^2 values. */
static inline void sh_basis(lane *basis, int degree, lane x, lane y, lane z)
{
    basis[0] = (lane)SH_C0;
    if (degree < 1)
        return;
    basis[1] = -SH_C1 * y;
    basis[2] = SH_C1 * z;
    basis[3] = -SH_C1 * x;
    if (degree < 2)
        return;
    const lane xx = x * x, yy = y * y, zz = z * z;
    basis[4] = SH_C2A * x * y;
    basis[5] = -SH_C2A * y * z;
    basis[6] = SH_C2B * (2 * zz - xx - yy);
    basis[7] = -SH_C2A * x * z;
    basis[8] = SH_C2C * (xx - yy);
    if (degree < 3)
        return;
    basis[9] = -SH_C3A * y * (3 * xx - yy);
    basis[10] = SH_C3B * x * y * z;
    basis[11] = -SH_C3C * y * (4 * zz - xx - yy);
    basis[12] = SH_C3D * z * (2 * zz - 3 * xx - 3 * yy);
    basis[13] = -SH_C3C * x * (4 * zz - xx - yy);
    basis[14] = SH_C3E * z * (xx - yy);
    basis[15] = -SH_C3A * x * (xx - 3 * yy);
}

/* Adds weight[k] * d basis[k] / d direction to (dx, dy, dz), without normalization of the direction. */
static inline void sh_direction_gradient(
    const lane *weight, int degree, lane x, lane y, lane z, lane *dx, lane *dy, lane *dz)
{
    if (degree < 1)
        return;
    *dy -= SH_C1 * weight[1];
    *dz += SH_C1 * weight[2];
    *dx -= SH_C1 * weight[3];
    if (degree < 2)
        return;
    *dx += SH_C2A * (y * weight[4] - z * weight[7])
        + 2 * x * (SH_C2C * weight[8] - SH_C2B * weight[6]);
    *dy += SH_C2A * (x * weight[4] - z * weight[5])
        - 2 * y * (SH_C2C * weight[8] + SH_C2B * weight[6]);
    *dz += 4 * SH_C2B * z * weight[6] - SH_C2A * (y * weight[5] + x * weight[7]);
    if (degree < 3)
        return;
    const lane xx = x * x, yy = y * y, zz = z * z, xy = x * y, yz = y * z, xz = x * z;
    *dx += -6 * SH_C3A * xy * weight[9] + SH_C3B * yz * weight[10] + 2 * SH_C3C * xy * weight[11]
        - 6 * SH_C3D * xz * weight[12] - SH_C3C * (4 * zz - 3 * xx - yy) * weight[13]
        + 2 * SH_C3E * xz * weight[14] - 3 * SH_C3A * (xx - yy) * weight[15];
    *dy += -3 * SH_C3A * (xx - yy) * weight[9] + SH_C3B * xz * weight[10]
        - SH_C3C * (4 * zz - xx - 3 * yy) * weight[11] - 6 * SH_C3D * yz * weight[12]
        + 2 * SH_C3C * xy * weight[13] - 2 * SH_C3E * yz * weight[14]
        + 6 * SH_C3A * xy * weight[15];
    *dz += SH_C3B * xy * weight[10] - 8 * SH_C3C * yz * weight[11]
        + 3 * SH_C3D * (2 * zz - xx - yy) * weight[12] - 8 * SH_C3C * xz * weight[13]
        + SH_C3E * (xx - yy) * weight[14];
}

/* Weights the last band if built with FADED. */
static inline void fade_last_band(lane *coefficients, int degree, __global const wide *camera)
{
#ifdef FADED
    const real weight = camera[CAMERA_LAST_BAND];
    for (int k = degree * degree; k < (degree + 1) * (degree + 1); k++)
        coefficients[k] *= weight;
#endif
}
