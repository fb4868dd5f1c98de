"""Where to stand for a picture, in the words of a photographer: relative to photographs that exist."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from statistics import median
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera

MIN_STEP, MAX_STEP = 4.0, 20.0
"""Limits of a step, degrees as seen from the subject."""
_BETWEEN = 0.25
"""Share of the way between two photographs from which on a place is between them."""
_OFF_THE_MIDDLE = 0.15
"""Share of that way from the middle on which a place is nearer to one of the two."""
_HALF_STEP = 0.25
"""Distances below this many steps are not mentioned."""
_MIN_NEARER = 0.75
"""Differences in distance below this many steps are not mentioned: they depend on the aim."""
_MAX_ASIDE = 0.5
"""A place farther aside from the line between two photographs is not between them; in units of its length."""
_WIDE = 25.0
"""Degrees around the subject that are mentioned beside the steps."""


@dataclass(frozen=True, eq=False)
class Photographs:
    """The photographs that exist, and what a step is.

    Args:
        names: of the photographs.
        cameras: theirs; at least one.
        reach: distance from each to the subject along its axis, world units, > 0.
    """

    names: tuple[str, ...]
    cameras: tuple[Camera, ...]
    reach: tuple[float, ...]

    @cached_property
    def up(self) -> Tensor:
        """The mean up direction, `[3]` float64, unit length, world axes."""
        import torch

        from registry.toolkit.drawing import upwards

        return torch.from_numpy(upwards(self.cameras))

    @cached_property
    def centers(self) -> Tensor:
        """The camera centers, `[N, 3]` float64, world units."""
        import torch

        return torch.stack([camera.center for camera in self.cameras])

    @cached_property
    def step(self) -> float:
        """Typical distance between neighbours, world units; 4 to 20 degrees as seen from the subject."""
        import torch

        apart = torch.cdist(self.centers, self.centers).fill_diagonal_(math.inf)
        low, high = (
            median(self.reach) * math.tan(math.radians(angle)) for angle in (MIN_STEP, MAX_STEP)
        )
        return min(max(float(apart.amin(dim=1).median()), low), high)

    @property
    def step_words(self) -> str:
        """What a step is, relative to the distance to the subject."""
        return f"A step is {self.step / median(self.reach):.0%} of the distance to the subject."

    def target(self, index: int) -> Tensor:
        """Return the point that a photograph is aimed at, `[3]` float64, world units."""
        camera = self.cameras[index]
        return camera.center + self.reach[index] * camera.world_to_camera[2, :3]

    def nearest(self, place: Tensor) -> int:
        """Return the index of the photograph nearest to a place `[3]`."""
        return int((self.centers - place).norm(dim=1).argmin())

    def words(self, camera: Camera, reach: float) -> str:
        """Return where to stand and where to aim for a picture by this camera.

        Args:
            reach: distance to what is on the camera's axis, world units.
        """
        target = camera.center + reach * camera.world_to_camera[2, :3]
        return f"{self._place(camera.center, target)}; aim at {self._aim(camera.center, target)}"

    def _place(self, place: Tensor, target: Tensor) -> str:
        index = self.nearest(place)
        origin, aside = self.centers[index], self._aside(self.centers[index], place, target)
        where = (
            f"{aside} of {self.names[index]}" if aside else f"where {self.names[index]} was taken"
        )
        pair = self._pair_around(place, target) if aside else None
        if pair is not None:
            first, second, share = pair
            origin = (1 - share) * self.centers[first] + share * self.centers[second]
            names = self.names[first], self.names[second]
            where = f"between {names[0]} and {names[1]}"
            if abs(share - 0.5) > _OFF_THE_MIDDLE:
                where += f", nearer to {names[share > 0.5]}"
        return ", ".join([where, *self._heights(origin, place, target)])

    def _pair_around(self, place: Tensor, target: Tensor) -> tuple[int, int, float] | None:
        """Return the nearest two photographs that a place is between, and its share of the way."""
        found = []
        for first in range(len(self.cameras)):
            for second in range(first + 1, len(self.cameras)):
                way = self._level(self.centers[second] - self.centers[first], target, place)
                length = float(way.norm())
                if length < 1e-9:
                    continue
                offset = self._level(place - self.centers[first], target, place)
                share = float(offset @ way) / length**2
                aside = float((offset - share * way).norm()) / length
                if _BETWEEN <= share <= 1 - _BETWEEN and aside < _MAX_ASIDE:
                    found.append((length, first, second, share))
        return min(found)[1:] if found else None

    def _level(self, vector: Tensor, target: Tensor, place: Tensor) -> Tensor:
        """Return the part of a vector that is sideways for somebody at a place who looks at the target."""
        import torch

        ahead = torch.nn.functional.normalize(target - place, dim=0)
        right = torch.linalg.cross(ahead, self.up)
        right = right / right.norm().clamp(min=1e-9)
        part: Tensor = (vector @ right) * right
        return part

    def _aside(self, origin: Tensor, place: Tensor, target: Tensor) -> str:
        """Return how far to the right or left of a photograph a place is, around the target."""
        import torch

        here, there = (
            (one - target) - ((one - target) @ self.up) * self.up for one in (origin, place)
        )
        sine = float(torch.linalg.cross(here, there) @ self.up)
        angle = math.atan2(sine, float(here @ there))
        words = _steps(abs(angle) * float(there.norm()) / self.step)
        if not words:
            return ""
        wide = abs(math.degrees(angle))
        around = f" ({wide:.0f}° around the subject)" if wide >= _WIDE else ""
        return f"{words}{around} to the {'right' if angle > 0 else 'left'}"

    def _heights(self, origin: Tensor, place: Tensor, target: Tensor) -> list[str]:
        height = float((place - origin) @ self.up)
        nearer = float((origin - target).norm() - (place - target).norm())
        words = [
            (_steps(abs(height) / self.step), "higher" if height > 0 else "lower"),
            (_steps(abs(nearer) / self.step), "closer" if nearer > 0 else "farther away"),
        ]
        if abs(nearer) < _MIN_NEARER * self.step:
            words.pop()
        return [f"{steps} {way}" for steps, way in words if steps]

    def _aim(self, place: Tensor, target: Tensor) -> str:
        """Return where a target is in the nearest photograph that shows it."""
        order = (self.centers - place).norm(dim=1).argsort().tolist()
        for index in order:
            camera = self.cameras[index]
            u, v, z = (float(one) for one in camera.project(target))
            if z > 0 and 0 <= u <= camera.width and 0 <= v <= camera.height:
                across = _third(u / camera.width, ("left", "", "right"))
                along = _third(v / camera.height, ("upper", "", "lower"))
                part = f"{along} {across}".strip()
                where = f"{part} part" if part else "middle"
                return f"what is in the {where} of {self.names[index]}"
        return "what no photograph shows yet"


def _third(share: float, words: tuple[str, str, str]) -> str:
    return words[min(int(3 * share), 2)]


def _steps(count: float) -> str:
    """Return a distance in words, to half a step; empty if it is less than that."""
    halves = round(2 * count)
    if count < _HALF_STEP or not halves:
        return ""
    if halves == 1:
        return "half a step"
    if halves == 2:
        return "one step"
    return f"{halves / 2:g} steps"
