"""Facts about a loaded scene as text, and warnings about likely problems."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations

import torch

from core_rasterizer import Camera

from ..contract.scene import Scene, View
from ..messages.suggestions import listing

FEW_POINTS = 100
"""Number of sparse points below which most of a scene is unknown."""
FEW_POINTS_IN_VIEW = 30
SMALL_BASELINE = 0.01
"""In units of the scene's depth; the error of triangulated depths is then as large as the depths."""
WIDE_ANGLE = 45.0
"""Degrees between two views; features are rarely matched beyond."""


def summary(scene: Scene) -> str:
    """Return the main facts in one line, for the start of a run."""
    points = f"{len(scene.points):,} points" if scene.points is not None else "no points"
    return (
        f"{scene.name}: {len(scene.train)} training views, {len(scene.test)} test views, "
        f"{_sizes(scene.train)}, depth {_span(scene.bounds)}, {points}"
    )


def facts(scene: Scene) -> list[tuple[str, str]]:
    """Return the facts of a scene, each as label and text."""
    views = (*scene.train, *scene.test)
    masked = sum(view.mask is not None for view in views)
    with_depth = sum(view.depth is not None for view in views)
    offset_x = _range(views, lambda camera: camera.cx - camera.width / 2)
    offset_y = _range(views, lambda camera: camera.cy - camera.height / 2)
    return [
        ("views", f"{len(views)}: {len(scene.train)} train, {len(scene.test)} test"),
        ("train", listing(view.name for view in scene.train)),
        ("test", listing(view.name for view in scene.test)),
        ("size", _sizes(views)),
        ("focal x", _range(views, lambda camera: camera.fx)),
        ("focal y", _range(views, lambda camera: camera.fy)),
        ("center off", f"x {offset_x}, y {offset_y}"),
        ("depth", _span(scene.bounds)),
        ("points", _points(scene)),
        ("masks", f"{masked} of {len(views)} views" if masked else "none"),
        ("true depth", f"{with_depth} of {len(views)} views" if with_depth else "none"),
        ("background", " ".join(f"{channel:g}" for channel in scene.background)),
    ]


def warnings(scene: Scene) -> list[str]:
    """Return a sentence for each property of the training views that is likely to spoil the result."""
    return [*_about_points(scene), *_about_baselines(scene), *_about_angles(scene)]


def points_in_view(scene: Scene, view: View) -> int:
    """Return the number of the scene's points in front of a view and inside its image."""
    if scene.points is None:
        return 0
    camera = view.camera
    return int(camera.contains(*camera.project(scene.points.positions), border=True).sum())


def _about_points(scene: Scene) -> Iterator[str]:
    """Without points there is no warning: initializers that need points raise an error."""
    if scene.points is None or not len(scene.points):
        return
    if len(scene.points) < FEW_POINTS:
        yield f"there are only {len(scene.points)} sparse points"
    for view in scene.train:
        inside = points_in_view(scene, view)
        if inside < FEW_POINTS_IN_VIEW:
            yield f"the training view {view.name} has only {inside} sparse points in it"


def _about_baselines(scene: Scene) -> Iterator[str]:
    if len(scene.train) == 1:
        yield "depth cannot be estimated from a single training view"
    depth = typical_depth(scene)
    for first, second in combinations(scene.train, 2):
        baseline = float((first.camera.center - second.camera.center).norm())
        if baseline < SMALL_BASELINE * depth:
            yield (
                f"the training views {first.name} and {second.name} were taken from nearly one place: "
                f"{baseline / depth:.2%} of the scene's depth apart"
            )


def _about_angles(scene: Scene) -> Iterator[str]:
    """Views whose direction differs from that of every other view."""
    if len(scene.train) < 2:
        return
    axes = torch.stack([view.camera.world_to_camera[2, :3] for view in scene.train])
    cosines = (axes @ axes.T).fill_diagonal_(-1.0)
    nearest = cosines.max(dim=1).values.clamp(-1, 1)
    for view, cosine in zip(scene.train, nearest, strict=True):
        angle = math.degrees(math.acos(float(cosine)))
        if angle > WIDE_ANGLE:
            yield (
                f"the training view {view.name} looks {angle:.0f} degrees away from every other one: "
                "little of it can be matched"
            )


def typical_depth(scene: Scene) -> float:
    """Return the median depth of the points in front of the training views, world units.

    Without points, the geometric mean of the bounds.
    """
    near, far = scene.bounds
    positions = torch.empty(0, 3) if scene.points is None else scene.points.positions
    rows = [view.camera.world_to_camera[2] for view in scene.train]
    depths = torch.cat([positions.double() @ row[:3] + row[3] for row in rows])
    before = depths[depths > 0]
    return float(before.median()) if len(before) else math.sqrt(near * far)


def _sizes(views: Sequence[View]) -> str:
    sizes = [f"{view.camera.width}x{view.camera.height}" for view in views]
    distinct = list(dict.fromkeys(sizes))
    if len(distinct) == 1:
        return distinct[0]
    return ", ".join(f"{size} ({sizes.count(size)} views)" for size in distinct)


def _range(views: Sequence[View], number: Callable[[Camera], float]) -> str:
    values = [number(view.camera) for view in views]
    low, high = min(values), max(values)
    return f"{low:.1f} px" if high - low < 0.05 else f"{low:.1f} .. {high:.1f} px"


def _span(bounds: tuple[float, float]) -> str:
    return f"{bounds[0]:.4g} .. {bounds[1]:.4g}"


def _points(scene: Scene) -> str:
    if scene.points is None or not len(scene.points):
        return "none"
    counts = [points_in_view(scene, view) for view in scene.train]
    return f"{len(scene.points):,}; {min(counts):,} to {max(counts):,} in each training view"
