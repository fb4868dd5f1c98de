"""Accuracy of multi-view depth priors, for `benchmarks.priors`.

The procedural room has exact depth; its cameras are further apart the fewer they are. For photographs in the
folder STEREOGS_DATA the truth is the points of the reconstruction from *all* of them; without such a file,
points triangulated from the training views, or the silhouette of an object, on which all depths should lie.

A training view is compared at the points that it sees and that at least three photographs see: many of the
others are wrong. The filter is that of the initializer `consistency_dense`: a depth must return from another
view within 2 pixels and 5 %, and belong to a patch of at least 100 pixels.
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

from benchmarks.results_plan import CASES
from benchmarks.trainings import DATA, PIPELINES
from core_rasterizer import Device
from registry import Context, Scene, View
from registry.priors import MultiViewDepthPrior
from registry.toolkit.images import grey
from registry.toolkit.views.triangulation import triangulate
from stereogs.session import build_pipeline, load_scene
from stereogs_plugins.initializers.consistency_dense.geometric_consistency import (
    Limits,
    consistent_depths,
    without_small_patches,
)
from stereogs_plugins.priors.onnx_mvs import OnnxMvs, OnnxMvsSettings
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
MIN_TRACK = 3
"""Fewest photographs that see a point."""
SLANTED = 60.0
"""Smallest angle, in degrees, between the normal and the viewing ray of a slanted surface."""
EVEN = 0.02
"""Largest standard deviation of grey values in 7x7 pixels of an untextured surface."""


@dataclass(frozen=True, eq=False)
class Known:
    """A scene and its known depths.

    Args:
        name: Name in the table.
        scene: The scene.
        seen: Points `[P, 3]` that each training view sees, or None.
    """

    name: str
    scene: Scene
    seen: Sequence[Tensor] | None = None


def reconstructed(file: Path, scene: Scene) -> list[Tensor]:
    """Return the points that each training view sees, from the reconstruction of an LLFF scene.

    Args:
        file: Its `points3d.npz`.
        scene: The scene.
    """
    with np.load(file) as arrays:
        positions, lengths = arrays["xyz"].astype(np.float64), arrays["track_len"]
        owners, photographs = np.repeat(np.arange(len(lengths)), lengths), arrays["track_image_ids"]
    numbers: Any = scene.fact("train_photographs")
    found = []
    for number in numbers:
        seen = np.unique(owners[photographs == number + 1])
        found.append(torch.from_numpy(positions[seen[lengths[seen] >= MIN_TRACK]]))
    return found


def triangulated(scene: Scene) -> list[Tensor]:
    """Return the points that each training view sees, triangulated from the training views."""
    found = triangulate(
        scene.train, scene.bounds, max_reprojection_error=1.0, min_angle=1.5, seed=0
    )
    agreed = found.seen_by.sum(dim=1) >= MIN_TRACK
    return [found.positions[agreed & seen].double() for seen in found.seen_by.unbind(dim=1)]


def point_errors(scene: Scene, seen: Sequence[Tensor], depths: Sequence[DepthImage]) -> Floats:
    """Return relative depth errors of all training views at the points they see; inf where depth is 0.

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
    """Keep the depths that another view confirms, without small patches; set others to 0."""
    kept = consistent_depths(
        [view.camera for view in scene.train],
        depths,
        Limits(2, 0.05, 1, scene.bounds),
    )
    return [without_small_patches(depth, min_pixels=100, max_step=0.05) for depth in kept]


@dataclass(frozen=True, eq=False)
class PriorRow:
    """Confirmed depths of one prior in one scene.

    Args:
        scene: Name of the scene.
        part: Pixels that count: "all", "slanted", "even" or "object".
        prior: Name of the prior.
        kept: Share of these pixels whose depth is confirmed.
        right: Shares of the confirmed depths within each of `TOLERANCES`; for an object the share of all
            confirmed depths that lie on it.
        cpu_seconds: CPU seconds of the prior for a view.
    """

    scene: str
    part: str
    prior: str
    kept: float
    right: tuple[float, ...]
    cpu_seconds: float


def measure(device: Device, network: Path) -> list[PriorRow]:
    """Measure each prior in each scene whose data are present.

    Args:
        device: Device of the priors.
        network: IterMVS as an ONNX file; skipped if missing.
    """
    rows = []
    for known in _scenes(device):
        for name, prior in _priors(device, network).items():
            begin = time.process_time()
            maps = prior.depths(known.scene.train, known.scene.bounds)
            seconds = (time.process_time() - begin) / len(maps)
            depths = [np.where(m.valid.numpy(), m.depth.numpy(), np.float32(0)) for m in maps]
            for part, kept, right in _scores(known, filtered(known.scene, depths)):
                rows.append(PriorRow(known.name, part, name, kept, right, seconds))
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
    """Part, share confirmed, shares right: for all pixels, and in the room for two kinds of surface."""
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
    """The share of the counted pixels that have a depth."""
    found = sum(int((depth > 0)[mask].sum()) for depth, mask in zip(depths, masks, strict=True))
    return found / sum(int(mask.sum()) for mask in masks)


def _within(errors: Floats) -> tuple[float, ...]:
    """Shares of the finite errors; infinite ones belong to points without a depth."""
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
    """Pixels of the object, by the mask or by the alpha channel."""
    shown = view.mask if view.mask is not None else view.alpha
    assert shown is not None  # otherwise the truth is points, see `_seen`
    return shown.numpy() > 0.5


def _slanted(view: View) -> Mask:
    """Pixels whose true surface is seen at a flat angle."""
    u, v = view.camera.pixel_centers()
    points = view.camera.unproject(u, v, torch.from_numpy(_truth(view))).numpy()
    normals = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    rays = points - view.camera.center.numpy()
    lengths = np.linalg.norm(normals, axis=-1) * np.linalg.norm(rays, axis=-1)
    slanted: Mask = np.abs((normals * rays).sum(axis=-1)) < np.cos(np.radians(SLANTED)) * lengths
    return slanted


def _even(view: View) -> Mask:
    """Pixels almost without texture."""
    image = grey(view.image).double().numpy()
    variance = uniform_filter(image**2, 7) - uniform_filter(image, 7) ** 2
    even: Mask = variance < EVEN**2
    return even


def table(rows: Sequence[PriorRow]) -> list[list[str]]:
    """Return a header and, for each part of each scene, a row with a cell for each prior."""
    names = list(dict.fromkeys(row.prior for row in rows))
    lines = [["scene", "of", *names]]
    for scene, part in dict.fromkeys((row.scene, row.part) for row in rows):
        found = {row.prior: row for row in rows if (row.scene, row.part) == (scene, part)}
        lines.append([scene, part, *(_cell(found[name]) for name in names)])
    return lines


def seconds_table(rows: Sequence[PriorRow]) -> list[list[str]]:
    """Return a header and, for each scene, the CPU seconds of each prior for a view."""
    names = list(dict.fromkeys(row.prior for row in rows))
    lines = [["CPU seconds a view", *names]]
    for scene in dict.fromkeys(row.scene for row in rows):
        took = {row.prior: row.cpu_seconds for row in rows if row.scene == scene}
        lines.append([scene, *(f"{took[name]:.1f}" for name in names)])
    return lines


def _cell(row: PriorRow) -> str:
    return f"{row.kept:.0%}: {', '.join(f'{share:.1%}' for share in row.right)}"
