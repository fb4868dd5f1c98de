"""Multi-view depth priors against what is known of scenes, for `benchmarks.priors`.

Exact depth is known of the procedural room, whose cameras stand further apart the fewer there are. Of
photographs in the folder that STEREOGS_DATA names it is the points of the reconstruction from *all* of
them; where the data set brings none, points triangulated from the training views, or the silhouette of an
object, on which all depths should lie.

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
from torch import Tensor

from benchmarks.results_plan import CASES, DATA, PIPELINES
from core_rasterizer import Device
from registry import Context, MultiViewDepthPrior, Scene, View, grey
from registry.session import build_pipeline, load_scene
from registry.triangulation import triangulate
from stereogs_plugins.initializers.consistency_dense.confirming.geometric_filter import (
    Limits,
    consistent_depths,
    without_small_patches,
)
from stereogs_plugins.priors.onnx_mvs.prior import OnnxMvs, OnnxMvsSettings
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
TOLERANCES = (0.01, 0.03)
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
        seen: the points `[P, 3]` that each training view sees, or None.
    """

    name: str
    scene: Scene
    seen: Sequence[Tensor] | None = None


def reconstructed(file: Path, scene: Scene) -> list[Tensor]:
    """The points that each training view sees, of the reconstruction that an LLFF scene brings.

    Args:
        file: its `points3d.npz`.
    """
    with np.load(file) as arrays:
        positions, lengths = arrays["xyz"].astype(np.float64), arrays["track_len"]
        owners, photographs = np.repeat(np.arange(len(lengths)), lengths), arrays["track_image_ids"]
    numbers: Any = scene.fact("train_photographs")
    found = []
    for number in numbers:
        seen = np.unique(owners[photographs == number + 1])
        found.append(torch.from_numpy(positions[seen[lengths[seen] >= SHORTEST_TRACK]]))
    return found


def triangulated(scene: Scene) -> list[Tensor]:
    """The points that each training view sees, from the training views."""
    found = triangulate(
        scene.train, scene.bounds, max_reprojection_error=1.0, min_angle=1.5, seed=0
    )
    agreed = found.seen_by.sum(dim=1) >= SHORTEST_TRACK
    return [found.positions[agreed & seen].double() for seen in found.seen_by.unbind(dim=1)]


def point_errors(scene: Scene, seen: Sequence[Tensor], depths: Sequence[DepthImage]) -> Floats:
    """Relative depth errors of all training views at the points they see; inf where depth is 0.

    Args:
        seen: the points `[P, 3]` that each training view sees.
        depths: `[H, W]` z-depth for each training view.
    """
    errors = []
    for view, points, depth in zip(scene.train, seen, depths, strict=True):
        camera = view.camera
        projected = camera.project(points)
        inside = camera.contains(*projected).numpy()
        u, v, z = (values.numpy() for values in projected)
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


@dataclass(frozen=True, eq=False)
class Row:
    """What the views confirm of one prior's depths in one scene.

    Args:
        part: of the scene whose pixels count: "all", "slanted", "even" or "object".
        kept: share of these pixels whose depth is confirmed.
        right: of what is confirmed, the share that is right to each of `TOLERANCES`; of an object the
            share of all confirmed depths that lie on it.
        cpu_seconds: that the prior took for a view.
    """

    scene: str
    part: str
    prior: str
    kept: float
    right: tuple[float, ...]
    cpu_seconds: float


def measure(device: Device, network: Path) -> list[Row]:
    """What each prior finds in each scene that is there.

    Args:
        network: IterMVS as an ONNX file; left out where it is not there.
    """
    rows = []
    for known in _scenes(device):
        for name, prior in _priors(device, network).items():
            begin = time.process_time()
            maps = prior.depths(known.scene.train, known.scene.bounds)
            seconds = (time.process_time() - begin) / len(maps)
            depths = [np.where(m.valid.numpy(), m.depth.numpy(), np.float32(0)) for m in maps]
            for part, kept, right in _scores(known, filtered(known.scene, depths)):
                rows.append(Row(known.name, part, name, kept, right, seconds))
    return rows


def _priors(device: Device, network: Path) -> dict[str, MultiViewDepthPrior[Any]]:
    priors: dict[str, MultiViewDepthPrior[Any]] = {
        "plane_sweep": PlaneSweep(
            PlaneSweepSettings.model_validate({}), Context("plane_sweep", 0, device)
        ),
        "patch_match": PatchMatchPrior(
            PatchMatchSettings.model_validate({}), Context("patch_match", 0, device)
        ),
    }
    if network.is_file():
        settings = OnnxMvsSettings.model_validate(
            {"model": network, "size": (512, 384), "min_confidence": 0.3}
        )
        priors["IterMVS"] = OnnxMvs(settings, Context("network", 0, device))
    return priors


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
            scene = load_scene(pipeline, device=device)
            yield Known(f"{name}, {views} views", scene, _seen(root / name, scene))


def _seen(folder: Path, scene: Scene) -> list[Tensor] | None:
    """The points that training views of photographs see; None if an object's silhouette is known."""
    if (folder / "points3d.npz").is_file():
        return reconstructed(folder / "points3d.npz", scene)
    known = all(view.mask is not None or view.alpha is not None for view in scene.train)
    return None if known else triangulated(scene)


def _scores(
    known: Known, depths: Sequence[DepthImage]
) -> Iterator[tuple[str, float, tuple[float, ...]]]:
    """Part, share confirmed, shares right: for all pixels, and of the room for two kinds of surface."""
    views = known.scene.train
    if views[0].depth is not None:
        for part, mask in (("all", _whole), ("slanted", _slanted), ("even", _even)):
            masks = [mask(view) for view in views]
            yield part, _share(masks, depths), _within(_exact_errors(views, masks, depths))
    elif known.seen is not None:
        errors = point_errors(known.scene, known.seen, depths)
        yield "all", _share(list(map(_whole, views)), depths), _within(errors)
    else:
        objects = [_silhouette(view) for view in views]
        found = [depth > 0 for depth in depths]
        on = sum(int((f & o).sum()) for f, o in zip(found, objects, strict=True))
        right = on / max(1, sum(int(f.sum()) for f in found))
        yield "object", _share(objects, depths), (right,)


def _share(masks: Sequence[Mask], depths: Sequence[DepthImage]) -> float:
    """Of the pixels that count, those with a depth."""
    found = sum(int((depth > 0)[mask].sum()) for depth, mask in zip(depths, masks, strict=True))
    return found / sum(int(mask.sum()) for mask in masks)


def _within(errors: Floats) -> tuple[float, ...]:
    """Shares of the errors that are finite; the others belong to points without a depth."""
    known = errors[np.isfinite(errors)]
    return tuple(float((known < limit).mean()) for limit in TOLERANCES)


def _exact_errors(
    views: Sequence[View], masks: Sequence[Mask], depths: Sequence[DepthImage]
) -> Floats:
    errors = []
    for view, mask, depth in zip(views, masks, depths, strict=True):
        truth = _truth(view)
        counts = mask & (depth > 0)
        errors.append((np.abs(depth - truth)[counts] / truth[counts]).astype(np.float64))
    return np.concatenate(errors)


def _whole(view: View) -> Mask:
    return np.ones((view.camera.height, view.camera.width), dtype=np.bool_)


def _truth(view: View) -> DepthImage:
    assert view.depth is not None  # the procedural room knows every depth
    depth: DepthImage = view.depth.numpy()
    return depth


def _silhouette(view: View) -> Mask:
    """Where the view shows its object, by its mask or by its alpha channel."""
    shown = view.mask if view.mask is not None else view.alpha
    assert shown is not None  # else the truth is points, see `_seen`
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


def table(rows: Sequence[Row]) -> list[list[str]]:
    """What `measure` found: a header, and for each part of each scene a line with all priors side by side."""
    names = list(dict.fromkeys(row.prior for row in rows))
    lines = [["scene", "of", *names]]
    for scene, part in dict.fromkeys((row.scene, row.part) for row in rows):
        found = {row.prior: row for row in rows if (row.scene, row.part) == (scene, part)}
        lines.append([scene, part, *(_cell(found[name]) for name in names)])
    return lines


def seconds_table(rows: Sequence[Row]) -> list[list[str]]:
    """A header, and for each scene the CPU seconds that a view took."""
    names = list(dict.fromkeys(row.prior for row in rows))
    lines = [["CPU seconds a view", *names]]
    for scene in dict.fromkeys(row.scene for row in rows):
        took = {row.prior: row.cpu_seconds for row in rows if row.scene == scene}
        lines.append([scene, *(f"{took[name]:.1f}" for name in names)])
    return lines


def _cell(row: Row) -> str:
    return f"{row.kept:.0%}: {', '.join(f'{share:.1%}' for share in row.right)}"
