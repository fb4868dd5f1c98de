"""A loaded scene in one line, and warnings about likely problems."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from ..contract.scene import Scene, View
from ..messages.suggestions import counted

FEW_POINTS = 100
"""Number of sparse points below which most of a scene is unknown."""
FEW_POINTS_IN_VIEW = 30
SMALL_BASELINE = 0.01
"""In units of the scene's depth; the error of triangulated depths is then as large as the depths."""
EQUAL_DIGITS = 8
"""Camera centres that differ by less, relative to their coordinates, may differ by rounding only."""
WIDE_ANGLE = 45.0
"""Degrees between two views; features are rarely matched beyond."""
MOST = 3
"""Warnings of one kind that are written out; the others are counted."""


def summary(scene: Scene) -> str:
    """Return the main facts in one line, for the start of a run."""
    points = f"{len(scene.points):,} points" if scene.points is not None else "no points"
    near, far = scene.bounds
    train, test = counted(len(scene.train), "training view"), counted(len(scene.test), "test view")
    sizes = image_sizes(scene.train)
    return f"{scene.name}: {train}, {test}, {sizes}, depth {near:.4g} .. {far:.4g}, {points}"


def warnings(scene: Scene) -> list[str]:
    """Return a sentence for each property of the training views that is likely to spoil the result."""
    kinds = _about_points(scene), _about_baselines(scene), _about_angles(scene)
    return [text for kind in kinds for text in _shortened(list(kind))]


def _shortened(texts: list[str]) -> list[str]:
    more = len(texts) - MOST
    return [*texts[:MOST], f"{more} more warnings like the last one"] if more > 1 else texts


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
    elif _differ_by_rounding(scene.train):
        yield (
            f"the centres of all training cameras are equal to {EQUAL_DIGITS} digits: if they differ by "
            "rounding only, the photographs are from one position and contain no depth"
        )
        return
    centers = _centers(scene.train)
    pairs = torch.triu_indices(len(centers), len(centers), offset=1)  # in the order of `pdist`
    shares = torch.pdist(centers) / typical_depth(scene)
    near = torch.nonzero(shares < SMALL_BASELINE)[:, 0]
    for pair in near[shares[near].sort(stable=True).indices].tolist():
        first, second = (scene.train[index].name for index in pairs[:, pair].tolist())
        yield (
            f"the training views {first} and {second} were taken from nearly one place: "
            f"{float(shares[pair]):.2%} of the scene's depth apart"
        )


def _centers(views: Sequence[View]) -> Tensor:
    return torch.stack([view.camera.center for view in views])


def _differ_by_rounding(views: Sequence[View]) -> bool:
    centers = _centers(views)
    spread = (centers - centers[0]).abs().max()
    return bool(spread < 10.0**-EQUAL_DIGITS * centers.abs().max())


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


def image_sizes(views: Sequence[View]) -> str:
    """Return the sizes of the views' images as text."""
    sizes = Counter(f"{view.camera.width}x{view.camera.height}" for view in views)
    if len(sizes) == 1:
        return next(iter(sizes))
    return ", ".join(f"{size} ({counted(count, 'view')})" for size, count in sizes.items())
