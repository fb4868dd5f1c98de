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
    (
        "core_rasterizer/raster/kernels/bin.cl",
        "PREFETCH_TO_WRITE(slot_count + order[r + ORDER_AHEAD]);",
        ";",
    ): "a prefetch changes the time only",
    (
        "core_rasterizer/raster/kernels/sort_gpu.cl",
        "for (size_t i = begin + id; i < end; i += LIST_GROUP) {",
        "for (size_t i = begin + id; i <= end; i += LIST_GROUP) {",
    ): "`digit_at` answers NO_DIGIT at the end",
    (
        "core_rasterizer/raster/kernels/raster_gpu.cl",
        "for (int round = 0; round < GROUP + BUCKET - 1; round++) {",
        "for (int round = 0; round < GROUP + BUCKET + 1; round++) {",
    ): "pixels beyond the group are skipped",
    (
        "core_rasterizer/raster/kernels/pairs_gpu.cl",
        "STEPS(1);",
        ";",
    ): "it is empty, except in a test of the largest number of steps",
    (
        "core_rasterizer/optimization/kernels/photometric_gpu.cl",
        "if (id < 2 * TILE)",
        "if (id < 3 * TILE)",
    ): "the further sums are not stored; `make races` finds the access beyond the array",
    (
        "core_rasterizer/raster/kernels/raster_cpu.cl",
        "const real square = (level - (e < 0 ? e : 0) * nearest * nearest) / c;",
        "const real square = (level - (e < 0 ? e : 1) * nearest * nearest) / c;",
    ): "e is above 0 by rounding only, and more rows are kept, whose pixels decide",
    (
        "core_rasterizer/matching/kernels/patch_plane.cl",
        "x ^= x >> 15;",
        "x ^= x >> 16;",
    ): "another hash of the same kind",
    (
        "stereogs_plugins/scenes/photos/photogrammetry/two_view.py",
        "essential = np.cross(shift, turn, axisb=0, axisc=0)",
        "essential = np.cross(turn, shift, axisb=0, axisc=0)",
    ): "distances do not depend on the sign of the matrix",
    (
        "registry/toolkit/photos/copies.py",
        "deviation: Array = values / max(float(values.std()), 1e-9)",
        "deviation: Array = values / max(float(values.std()), 10 * 1e-9)",
    ): "only a plain picture, which is 0 before, is below either",
}
