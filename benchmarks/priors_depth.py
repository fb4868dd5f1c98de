"""Multi-view depth priors against what is known of scenes, for `benchmarks.priors`.

Exact depth is known of the procedural room, whose cameras stand further apart the fewer there are. Of
photographs in the folder that STEREOGS_DATA names it is the points of the reconstruction from *all* of
them, or the silhouette of an object, on which all depths should lie.

A training view is compared where it sees a point itself, and only with points that three photographs
or more see: of the others, many are wrong. The filter is that of the initializer `consistency_dense`: a
depth must come back from another view to within 2 pixels and 5 %, and belong to a patch of at least 100
pixels.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter  # type: ignore[attr-defined]

from benchmarks.results_plan import CASES, DATA, PIPELINES
from core_rasterizer import Device
from registry import Context, MultiViewDepthPrior, Scene, View, grey
from registry.session import build_pipeline, load_scene
from stereogs_plugins.initializers.consistency_dense.confirming.geometric_filter import (
    Limits,
    consistent_depths,
    without_small_patches,
)
from stereogs_plugins.priors.patch_match import PatchMatchPrior, PatchMatchSettings
from stereogs_plugins.priors.plane_sweep import PlaneSweep, PlaneSweepSettings
from stereogs_plugins.scenes.procedural import ProceduralScene
from stereogs_plugins.scenes.procedural.loader import ProceduralSettings

Floats = NDArray[np.float64]
DepthImage = NDArray[np.float32]
Mask = NDArray[np.bool_]

ROOMS = (2, 3, 6)
"""Views of the room: 22, 11 and 4.4 degrees between neighbours."""
PHOTOGRAPHS = (
    ("llff_fern", 3),
    ("llff_flower", 3),
    ("mip360_bonsai", 12),
    ("dtu_scan24", 3),
    ("dtu_scan65", 6),
    ("blender_lego", 8),
)
"""Data sets and numbers of training views, each by its protocol."""
TOLERANCES = (0.01, 0.03, 0.1)
"""Relative depth errors."""
SHORTEST_TRACK = 3
"""Photographs that must see a point."""
SLANTED = 60.0
"""Degrees between a surface's normal and the viewing ray from which on it counts as slanted."""
EVEN = 0.02
"""Standard deviation of grey values in 7x7 pixels up to which a surface counts as without texture."""


@dataclass(frozen=True, eq=False)
class Known:
    """A scene and what is known of its depths.

    Args:
        name: for the table.
        points: the file of reconstructed points, or None.
    """

    name: str
    scene: Scene
    points: Path | None = None


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
        Limits(reprojection=2, depth=0.05, views=1, bounds=scene.bounds),
    )
    return [without_small_patches(depth, min_pixels=100, max_step=0.05) for depth in kept]


def measure(device: Device, features: Path | None = None) -> list[dict[str, Any]]:
    """What each prior finds in each scene that is there.

    Args:
        features: an ONNX file for `plane_sweep` with the cost `features`, tried where points are
            known; None leaves it out.

    Returns:
        Rows with the keys `scene`, `prior`, `stage` ("raw" or "filtered"), `part` ("" or the pixels
        that count), `kept` (share of these that have a depth), `within` (shares of those that have
        one, for each of `TOLERANCES`; None where no depth is known), `on_object` (share of all depths
        that lie on the object; None where there is no silhouette) and `cpu_seconds` a view.
    """
    rows = []
    for known in _scenes(device):
        priors: dict[str, MultiViewDepthPrior[Any]] = {
            "plane_sweep": PlaneSweep(
                PlaneSweepSettings.model_validate({}), Context("plane_sweep", 0, device)
            ),
            "patch_match": PatchMatchPrior(
                PatchMatchSettings.model_validate({}), Context("patch_match", 0, device)
            ),
        }
        if features is not None and known.points is not None:
            chosen = PlaneSweepSettings.model_validate({"cost": "features", "features": features})
            priors["plane_sweep, features"] = PlaneSweep(chosen, Context("features", 0, device))
        for name, prior in priors.items():
            begin = time.process_time()
            depths = [a.depth.numpy() for a in prior.depths(known.scene.train, known.scene.bounds)]
            seconds = (time.process_time() - begin) / len(depths)
            for stage, kept in (("raw", depths), ("filtered", filtered(known.scene, depths))):
                for row in _scores(known, kept):
                    rows.append(
                        {"scene": known.name, "prior": name, "stage": stage, **row}
                        | {"cpu_seconds": seconds}
                    )
    return rows


def _scenes(device: Device) -> Iterator[Known]:
    for views in ROOMS:
        settings = ProceduralSettings.model_validate({"train_views": views, "test_views": 0})
        scene = ProceduralScene(settings, Context("scene", 0, device)).load()
        yield Known(f"room, {views} views", scene)
    root = Path(os.environ.get(DATA, "."))
    cases = {(case.data, case.views): case for case in CASES}
    for name, views in PHOTOGRAPHS:
        if (root / name).is_dir():
            case = cases[name, views]
            pipeline = build_pipeline(PIPELINES / "weightfree_fast.yaml", case.overrides)
            points = root / name if (root / name / "points3d.npz").is_file() else None
            yield Known(f"{name}, {views} views", load_scene(pipeline, device=device), points)


def _scores(known: Known, depths: Sequence[DepthImage]) -> Iterator[dict[str, Any]]:
    """A row for all pixels, and for the room one for its slanted and one for its even surfaces."""
    views = known.scene.train
    whole = [np.ones(depth.shape, dtype=np.bool_) for depth in depths]
    if known.points is not None:
        yield _row("", whole, depths, point_errors(known.points, known.scene, depths))
    elif views[0].depth is not None:
        yield _exact("", views, whole, depths)
        yield _exact("slanted", views, [_slanted(view) for view in views], depths)
        yield _exact("even", views, [_even(view) for view in views], depths)
    else:
        objects = [_silhouette(view) for view in views]
        yield _row("object", objects, depths, None) | {"on_object": _lying_on(objects, depths)}


def _exact(
    part: str, views: Sequence[View], masks: Sequence[Mask], depths: Sequence[DepthImage]
) -> dict[str, Any]:
    errors = []
    for view, mask, depth in zip(views, masks, depths, strict=True):
        truth = _truth(view)
        counts = mask & (depth > 0)
        errors.append(np.abs(depth - truth)[counts] / truth[counts])
    return _row(part, masks, depths, np.concatenate(errors))


def _row(
    part: str, masks: Sequence[Mask], depths: Sequence[DepthImage], errors: Floats | None
) -> dict[str, Any]:
    """Errors that are infinite belong to points without a depth."""
    found = sum(int((depth > 0)[mask].sum()) for depth, mask in zip(depths, masks, strict=True))
    known = None if errors is None else errors[np.isfinite(errors)]
    return {
        "part": part,
        "kept": found / sum(int(mask.sum()) for mask in masks),
        "within": None
        if known is None
        else [float((known < limit).mean()) for limit in TOLERANCES],
        "on_object": None,
    }


def _lying_on(objects: Sequence[Mask], depths: Sequence[DepthImage]) -> float:
    counts = [((d > 0) & m, d > 0) for d, m in zip(depths, objects, strict=True)]
    return float(sum(on.sum() for on, _ in counts) / max(1, sum(all_.sum() for _, all_ in counts)))


def _truth(view: View) -> DepthImage:
    assert view.depth is not None  # the procedural room knows every depth
    depth: DepthImage = view.depth.numpy()
    return depth


def _silhouette(view: View) -> Mask:
    """Where the view shows its object, by its mask or by its alpha channel."""
    shown = view.mask if view.mask is not None else view.alpha
    if shown is None:
        raise ValueError(f"nothing is known of the depths of {view.name}")
    return shown.numpy() > 0.5


def _slanted(view: View) -> Mask:
    """Where the true surface is seen at a flat angle."""
    u, v = view.camera.pixel_centers()
    points = view.camera.unproject(u, v, torch.from_numpy(_truth(view))).numpy()
    normals = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    rays = points - view.camera.center.numpy()
    lengths = np.linalg.norm(normals, axis=-1) * np.linalg.norm(rays, axis=-1)
    slanted: Mask = np.abs((normals * rays).sum(axis=-1)) < np.cos(np.radians(SLANTED)) * lengths
    return slanted


def _even(view: View) -> Mask:
    """Where the image has next to no texture."""
    image = grey(view.image).double().numpy()
    variance = uniform_filter(image**2, 7) - uniform_filter(image, 7) ** 2
    even: Mask = variance < EVEN**2
    return even


def table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """What `measure` found, a header and a row each."""
    limits = (f"within {limit:.0%}" for limit in TOLERANCES)
    lines = [["scene", "of", "prior", "depths", "kept", *limits, "on object", "CPU seconds a view"]]
    for row in rows:
        shares = [row["kept"], *(row["within"] or [None] * len(TOLERANCES)), row["on_object"]]
        numbers = ["" if value is None else f"{value:.3f}" for value in shares]
        names = [row["scene"], row["part"] or "all", row["prior"], row["stage"]]
        lines.append([*names, *numbers, f"{row['cpu_seconds']:.2f}"])
    return lines
