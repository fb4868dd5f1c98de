"""Candidates for the next picture: cameras between and around the photographs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import product
from statistics import median
from typing import TYPE_CHECKING

import torch

from registry.toolkit.views.virtual_views import looking_at

from .gain import MIN_ALPHA, small

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, Rendering

    from .where_to_stand import Photographs

SIDEWAYS = (-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5)
UPWARDS = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Steps from each photograph."""
SAME_PLACE = 0.4
"""Distance between two candidates, or a candidate and a photograph, at least; steps."""
MOST = 150
_TOO_NEAR, _MAX_IN_THE_WAY = 0.4, 0.2
"""Surfaces nearer than this share of the distance to the subject may cover this share of a picture."""
_MIDDLE = 0.6
"""Share of a picture's width and height that decides how far the subject is."""


def around(photographs: Photographs) -> list[Camera]:
    """Return cameras between neighbours, and on a grid around each photograph, that look at its subject."""
    places = [*_between_neighbours(photographs), *_around_each(photographs)]
    taken = [photographs.centers]
    found: list[Camera] = []
    for model, place, target in places:
        apart = (torch.cat(taken) - place).norm(dim=1).min()
        if float(apart) >= SAME_PLACE * photographs.step:
            taken.append(place[None])
            found.append(looking_at(model, place, target))
    return found if len(found) <= MOST else [found[k * len(found) // MOST] for k in range(MOST)]


_Place = tuple["Camera", "Tensor", "Tensor"]
"""A camera with the lens, a center, and a point to look at."""


def _between_neighbours(photographs: Photographs) -> list[_Place]:
    """Return the middle between each photograph and its two nearest, at three heights."""
    places = []
    for index in range(len(photographs.cameras)):
        distances = (photographs.centers - photographs.centers[index]).norm(dim=1)
        for other in distances.argsort().tolist()[1:3]:
            target = (photographs.target(index) + photographs.target(other)) / 2
            ends = torch.stack([photographs.centers[k] for k in (index, other)]) - target
            middle = ends.mean(dim=0)
            length = middle.norm()
            if float(length) < 0.5 * float(ends.norm(dim=1).mean()):  # they face each other
                continue
            middle = middle / length * ends.norm(dim=1).mean()
            for lift in (0.0, 0.5, -0.5):
                place = target + middle + lift * photographs.step * photographs.up
                places.append((photographs.cameras[index], place, target))
    return places


def _around_each(photographs: Photographs) -> list[_Place]:
    """Return places on a sphere around what each photograph is aimed at."""
    places = []
    for index, camera in enumerate(photographs.cameras):
        target = photographs.target(index)
        away = camera.center - target
        right = torch.linalg.cross(-away, photographs.up)
        if float(right.norm()) < 1e-6 * float(away.norm()):
            continue
        right = right / right.norm()
        for aside, lift in product(SIDEWAYS, UPWARDS):
            moved = away + photographs.step * (aside * right + lift * photographs.up)
            place = target + moved / moved.norm() * away.norm()
            places.append((camera, place, target))
    return places


def reaches(render: Callable[[Camera], Rendering], cameras: Sequence[Camera]) -> list[float]:
    """Return the median depth in the middle of what each camera sees, world units.

    The median of the others where a camera sees nothing.
    """
    found = [_reach(render(small(camera))) for camera in cameras]
    middle = median(list(filter(math.isfinite, found)) or [1.0])
    return [reach if math.isfinite(reach) else middle for reach in found]


def _reach(rendering: Rendering) -> float:
    height, width = rendering.alpha.shape
    rows, columns = (
        slice(round(side * (1 - _MIDDLE) / 2), round(side * (1 + _MIDDLE) / 2))
        for side in (height, width)
    )
    alpha, depth = rendering.alpha[rows, columns], rendering.depth[rows, columns]
    shown = alpha > MIN_ALPHA
    return float((depth[shown] / alpha[shown]).median()) if shown.any() else math.inf


def free_view(rendering: Rendering, reach: float) -> bool:
    """Return whether nothing is in the way between a candidate and its subject at this distance."""
    near = rendering.depth < _TOO_NEAR * reach * rendering.alpha
    return float((near & (rendering.alpha > MIN_ALPHA)).float().mean()) <= _MAX_IN_THE_WAY
