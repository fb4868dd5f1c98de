"""What a loader found, in words: facts for people before training, and what looks like trouble."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations

import torch

from core_rasterizer import Camera

from ..contract.scene import Scene, View

FEW_POINTS = 100
"""Fewer sparse points leave most of a scene to chance."""
FEW_POINTS_IN_VIEW = 30
SMALL_BASELINE = 0.01
"""In units of the scene's depth; triangulated depths are then off by as much as they say."""
WIDE_ANGLE = 45.0
"""Degrees between two views; features are hardly recognized beyond."""


def summary(scene: Scene) -> str:
    """The facts in one line, for the start of a run."""
    points = f"{len(scene.points):,} points" if scene.points is not None else "no points"
    return (
        f"{scene.name}: {len(scene.train)} training views, {len(scene.test)} test views, "
        f"{_sizes(scene.train)}, depth {_span(scene.bounds)}, {points}"
    )


def facts(scene: Scene) -> list[tuple[str, str]]:
    """Label and text of what the scene shows, in the order in which people read it."""
    views = (*scene.train, *scene.test)
    masked = sum(view.mask is not None for view in views)
    with_depth = sum(view.depth is not None for view in views)
    return [
        ("views", f"{len(views)}: {len(scene.train)} train, {len(scene.test)} test"),
        ("train", _names(scene.train)),
        ("test", _names(scene.test)),
        ("size", _sizes(views)),
        ("focal x", _range(views, lambda camera: camera.fx)),
        ("focal y", _range(views, lambda camera: camera.fy)),
        ("center off", _principal_offset(views)),
        ("depth", _span(scene.bounds)),
        ("points", _points(scene)),
        ("masks", f"{masked} of {len(views)} views" if masked else "none"),
        ("true depth", f"{with_depth} of {len(views)} views" if with_depth else "none"),
        ("background", " ".join(f"{channel:g}" for channel in scene.background)),
    ]


def warnings(scene: Scene) -> list[str]:
    """One sentence for each thing about the training views that is likely to spoil the result."""
    return [*_about_points(scene), *_about_baselines(scene), *_about_angles(scene)]


def points_in_view(scene: Scene, view: View) -> int:
    """How many of the scene's points lie inside the view's image, in front of it."""
    if scene.points is None:
        return 0
    camera = view.camera
    return int(camera.contains(*camera.project(scene.points.positions), border=True).sum())


def _about_points(scene: Scene) -> Iterator[str]:
    """Few are worse than none: initializers that need points and get none say so themselves."""
    count = len(scene.points) if scene.points is not None else 0
    if not count:
        return
    if count < FEW_POINTS:
        yield f"there are only {count} sparse points"
    for view in scene.train:
        inside = points_in_view(scene, view)
        if inside < FEW_POINTS_IN_VIEW:
            yield f"the training view {view.name} has only {inside} sparse points in it"


def _about_baselines(scene: Scene) -> Iterator[str]:
    if len(scene.train) == 1:
        yield "one training view alone says nothing about depth"
    depth = typical_depth(scene)
    for first, second in combinations(scene.train, 2):
        baseline = float((first.camera.center - second.camera.center).norm())
        if baseline < SMALL_BASELINE * depth:
            yield (
                f"the training views {first.name} and {second.name} were taken from nearly one place: "
                f"{baseline / depth:.2%} of the scene's depth apart"
            )


def _about_angles(scene: Scene) -> Iterator[str]:
    """Views that look elsewhere than every other one, or at it from another side."""
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
    """Median depth of the points before the training views; without points, the bounds' mean (geometric).

    World units.
    """
    near, far = scene.bounds
    if scene.points is None or not len(scene.points):
        return math.sqrt(near * far)
    depths = torch.cat(
        [
            scene.points.positions.double() @ view.camera.world_to_camera[2, :3]
            + view.camera.world_to_camera[2, 3]
            for view in scene.train
        ]
    )
    before = depths[depths > 0]
    return float(before.median()) if len(before) else math.sqrt(near * far)


def _names(views: Sequence[View]) -> str:
    return ", ".join(view.name for view in views) or "none"


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


def _principal_offset(views: Sequence[View]) -> str:
    """The principal point as seen from the image's centre."""
    x = _range(views, lambda camera: camera.cx - camera.width / 2)
    y = _range(views, lambda camera: camera.cy - camera.height / 2)
    return f"x {x}, y {y}"


def _span(bounds: tuple[float, float]) -> str:
    return f"{bounds[0]:.4g} .. {bounds[1]:.4g}"


def _points(scene: Scene) -> str:
    if scene.points is None or not len(scene.points):
        return "none"
    counts = [points_in_view(scene, view) for view in scene.train]
    return f"{len(scene.points):,}; {min(counts):,} to {max(counts):,} in each training view"
