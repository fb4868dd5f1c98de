"""Multi-view depth priors against reconstructed points, for `benchmarks.priors`.

Reads the LLFF scenes in the folder that STEREOGS_DATA names.

The truth is the points of the reconstruction from *all* photographs. A training view is compared where
it sees a point itself, and only with points that three photographs or more see: of the others, many are
wrong. The filter is that of the initializer `consistency_dense`: a depth must come back from another
view to within 2 pixels and 5 %, and belong to a patch of at least 100 pixels.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from core_rasterizer import Device
from registry import Context, Scene
from stereogs_plugins.initializers.consistency_dense.geometric_filter import (
    consistent_depths,
    without_small_patches,
)
from stereogs_plugins.priors.plane_sweep import PlaneSweep
from stereogs_plugins.scenes.llff import LLFFScene

Floats = NDArray[np.float64]
DepthImage = NDArray[np.float32]

NAMES = ("llff_fern", "llff_flower")
TOLERANCES = (0.01, 0.03, 0.1)
"""Relative depth errors."""
SHORTEST_TRACK = 3
"""Photographs that must see a point."""
REPEATS = 3


def point_errors(folder: Path, scene: Scene, depths: Sequence[DepthImage]) -> Floats:
    """Relative depth errors of all training views at the points they see; inf where depth is 0.

    Args:
        folder: of the LLFF scene, with `points3d.npz`.
        depths: `[H, W]` z-depth for each training view.
    """
    with np.load(folder / "points3d.npz") as arrays:
        positions, lengths = arrays["xyz"].astype(np.float64), arrays["track_len"]
        owners, photographs = np.repeat(np.arange(len(lengths)), lengths), arrays["track_image_ids"]
    errors = []
    numbers: Any = scene.fact("train_photographs")
    for view, number, depth in zip(scene.train, numbers, depths, strict=True):
        seen = np.unique(owners[photographs == number + 1])
        seen = seen[lengths[seen] >= SHORTEST_TRACK]
        camera, points = view.camera, torch.from_numpy(positions[seen])
        u, v, z = (values.numpy() for values in camera.project(points))
        inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height) & (z > 0)
        found = depth[v[inside].astype(int), u[inside].astype(int)]
        errors.append(np.where(found > 0, np.abs(found - z[inside]) / z[inside], np.inf))
    return np.concatenate(errors)


def filtered(scene: Scene, depths: Sequence[DepthImage]) -> list[DepthImage]:
    """The depths that another view confirms, without small patches; others are 0."""
    kept = consistent_depths(
        [view.camera for view in scene.train],
        depths,
        max_reprojection_error=2,
        max_depth_error=0.05,
        min_consistent=1,
        bounds=scene.bounds,
    )
    return [without_small_patches(depth, min_pixels=100, max_step=0.05) for depth in kept]


def measure(device: Device, features: Path | None = None) -> list[dict[str, Any]]:
    """Errors and times of each variant on each scene that is found, from three training views.

    Args:
        features: an ONNX file for the cost `features`, or None: that variant is left out.

    Returns:
        Rows with the keys `scene`, `variant`, `stage` ("raw" or "filtered"), `within` (shares of the
        points that have a depth, for each of `TOLERANCES`), `kept` (share of pixels with a depth), and
        the medians `seconds` and `cpu_seconds` for all views.
    """
    variants: dict[str, dict[str, Any]] = {"zncc": {}}
    if features is not None:
        variants["features"] = {"cost": "features", "features": features}
    root = Path(os.environ.get("STEREOGS_DATA", "."))
    rows = []
    for name in NAMES:
        if not (root / name).is_dir():
            continue
        settings = LLFFScene.Settings.model_validate({"path": root / name, "train_views": 3})
        scene = LLFFScene(settings, Context("scene", 0, device)).load()
        for variant, chosen in variants.items():
            prior = PlaneSweep(PlaneSweep.Settings(**chosen), Context("plane_sweep", 0, device))
            depths, times = _ask(prior, scene)
            for stage, kept in (("raw", depths), ("filtered", filtered(scene, depths))):
                errors = point_errors(root / name, scene, kept)
                errors = errors[np.isfinite(errors)]
                row = {
                    "scene": name,
                    "variant": variant,
                    "stage": stage,
                    "within": [float((errors < limit).mean()) for limit in TOLERANCES],
                    "kept": float(np.mean([(depth > 0).mean() for depth in kept])),
                }
                rows.append({**row, **times})
    return rows


def _ask(prior: PlaneSweep, scene: Scene) -> tuple[list[DepthImage], dict[str, float]]:
    """The answer, and the medians of what it took once the kernels were compiled."""
    depths = [answer.depth.numpy() for answer in prior.depths(scene.train, scene.bounds)]
    walls, processors = [], []
    for _ in range(REPEATS):
        wall, processor = time.perf_counter(), time.process_time()
        prior.depths(scene.train, scene.bounds)
        walls.append(time.perf_counter() - wall)
        processors.append(time.process_time() - processor)
    return depths, {"seconds": median(walls), "cpu_seconds": median(processors)}


def table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """What `measure` found, a header and a row each."""
    limits = (f"within {limit:.0%}" for limit in TOLERANCES)
    lines = [["scene", "cost", "depths", *limits, "kept", "seconds", "CPU seconds"]]
    for row in rows:
        numbers = [f"{value:.3f}" for value in (*row["within"], row["kept"])]
        times = [f"{row[key]:.2f}" for key in ("seconds", "cpu_seconds")]
        lines.append([row["scene"], row["variant"], row["stage"], *numbers, *times])
    return lines
