"""Mutants that behave like the code, with the reason: (file, line before, line after)."""

from __future__ import annotations

EQUIVALENT: dict[tuple[str, str, str], str] = {
    (
        "stereogs_plugins/regularizers/unseen_views/cycle_filtered_warping.py",
        "return inside & (z > 0) & ((returned - depth).abs() < limit)",
        "return inside & (z >= 0) & ((returned - depth).abs() < limit)",
    ): "at z = 0 the pixel is infinite or NaN, so `inside` is False",
    (
        "stereogs_plugins/scenes/photos/photogrammetry/dense/check.py",
        "points = np.array([model.points3D[key].xyz for key in sorted(seen)]).reshape(-1, 3)",
        "points = np.array([model.points3D[key].xyz for key in sorted(seen)]).reshape(-2, 3)",
    ): "numpy computes a dimension given as any negative number",
    (
        "stereogs_plugins/scenes/photos/photogrammetry/two_view.py",
        'return "position" if rotation_error(homography, size) < thresholds.MIN_DEVIATION else "surface"',
        'return "position" if rotation_error(homography, size) <= thresholds.MIN_DEVIATION else "surface"',
    ): "a measured angle is never exactly the threshold",
    (
        "core_rasterizer/raster/kernels/raster_gpu.cl",
        "sums[PAIR_ABSOLUTE_X] += fabs(d_p * (2 * g[REC_A] * dx + g[REC_B] * dy));",
        "sums[PAIR_ABSOLUTE_X] -= fabs(d_p * (2 * g[REC_A] * dx + g[REC_B] * dy));",
    ): "only its square is used",
    (
        "stereogs_plugins/scenes/photos/video_file.py",
        "position = np.cumsum([max(frame.motion, _MIN_MOTION) for frame in candidates])",
        "position = np.cumsum([max(_MIN_MOTION, frame.motion) for frame in candidates])",
    ): "the larger of two numbers does not depend on their order",
}
