"""Selected and deleted Gaussians, with undo; what gestures select; and the files that edits are saved to."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from core_rasterizer import Camera, Gaussians, save_ply

if TYPE_CHECKING:
    from core_rasterizer import Rendering

_MAX_UNDO = 100
_MIN_ALPHA = 0.05
"""Least alpha of a pixel with a surface."""
_SKIN = 0.02
"""Depth below the surface to which the brush reaches, as a share of the surface's depth."""

Corner = tuple[float, float]
"""A position in the image: 0 to 1 from left to right and from top to bottom."""


@dataclass(frozen=True, eq=False)
class Source:
    """Gaussians as their file holds them.

    Args:
        path: the PLY file; edited ones are written next to it.
        gaussians: returns the Gaussians in the file's coordinates, in the order of the viewer's.
        attributes: further numbers of each Gaussian, `[N]` by name.
        save_run: writes the Gaussians of a mask as a new run, and returns its folder; None without a run.
    """

    path: Path
    gaussians: Callable[[], Gaussians]
    attributes: Mapping[str, Tensor]
    save_run: Callable[[Tensor], Path] | None = None

    def save(self, kept: Tensor) -> Path:
        """Write Gaussians to a new file and return its path.

        Args:
            kept: mask `[N]` bool.

        Raises:
            PlyError: the file cannot be written.
        """
        whole = self.gaussians()
        part = Gaussians(**{name: values[kept] for name, values in vars(whole).items()})
        path = unused(self.path.with_suffix(""), ".ply")
        path.parent.mkdir(parents=True, exist_ok=True)
        save_ply(part, path, {name: values[kept] for name, values in self.attributes.items()})
        return path


def unused(path: Path, suffix: str) -> Path:
    """Return a path that does not exist: that of what is edited, with `-edited`, `-edited-2`, ..."""
    numbers = ("" if number == 1 else f"-{number}" for number in count(1))
    places = (path.with_name(f"{path.name}-edited{number}{suffix}") for number in numbers)
    return next(place for place in places if not place.exists())


class Edits:
    """Which Gaussians are selected and which are deleted.

    Args:
        number: of the Gaussians, N.

    Attributes:
        selected: mask `[N]` bool; deleted Gaussians are not selected.
        deleted: mask `[N]` bool.
        revision: grows with each change.
    """

    def __init__(self, number: int) -> None:
        self.revision = 0
        self.selected = torch.zeros(number, dtype=torch.bool)
        self.deleted = torch.zeros(number, dtype=torch.bool)
        self._before: deque[tuple[Tensor, Tensor]] = deque(maxlen=_MAX_UNDO)

    def select(self, mask: Tensor, *, add: bool, joins: bool = False) -> bool:
        """Add Gaussians to the selection, or remove them from it; return whether that changed it.

        Args:
            joins: whether undo takes back this change and the one before it together.
        """
        selected = self.selected | mask if add else self.selected & ~mask
        return self._change(selected, self.deleted, joins)

    def invert(self, shown: Tensor) -> None:
        """Select the Gaussians of `shown`, a mask `[N]` bool, that are not selected, and no other."""
        self._change(shown & ~self.selected, self.deleted)

    def delete(self) -> None:
        """Delete the selected Gaussians."""
        self._change(torch.zeros_like(self.selected), self.deleted | self.selected)

    def undo(self) -> None:
        """Take back the last change; the last 100 can be taken back."""
        if self._before:
            self.selected, self.deleted = self._before.pop()
            self.revision += 1

    def _change(self, selected: Tensor, deleted: Tensor, joins: bool = False) -> bool:
        selected = selected & ~deleted
        if selected.equal(self.selected) and deleted.equal(self.deleted):
            return False
        if not joins:
            self._before.append((self.selected, self.deleted))
        self.selected, self.deleted = selected, deleted
        self.revision += 1
        return True


def in_rectangle(means: Tensor, camera: Camera, low: Corner, high: Corner) -> Tensor:
    """Return a mask `[N]` bool of the means in front of a camera whose projections are in a rectangle."""
    u, v, z = camera.project(means)
    x, y = u / camera.width, v / camera.height
    return (z > 0) & (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])


class Stroke:
    """A stroke of the brush over a picture; it touches means that the surface in the picture does not hide.

    Args:
        means: `[N, 3]`, world units.
        shown: mask `[N]` bool of the Gaussians in the picture.
        rendering: the picture, of `camera`.
        place: where the stroke begins.

    Attributes:
        changed: whether the stroke has changed the selection; for its owner.
    """

    def __init__(
        self, means: Tensor, shown: Tensor, camera: Camera, rendering: Rendering, place: Corner
    ) -> None:
        u, v, z = camera.project(means)
        self._seen = shown & camera.contains(u, v, z)
        row, column = v[self._seen].long(), u[self._seen].long()
        alpha = rendering.alpha.detach()[row, column]
        depth = rendering.depth.detach()[row, column] / alpha.clamp(min=_MIN_ALPHA)
        hidden = (alpha >= _MIN_ALPHA) & (z[self._seen] > (1 + _SKIN) * depth)
        self._seen[self._seen.clone()] = ~hidden
        self._places = torch.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], 1)
        self._camera, self.changed = camera, False
        self._at = self._tangents(place)

    def to(self, place: Corner, radius: float) -> Tensor:
        """Move the brush to a place, and return a mask `[N]` bool of the means that it touches on the way.

        Args:
            radius: of the brush, as a share of the distance from the camera.
        """
        start, self._at = self._at, self._tangents(place)
        way = self._at - start
        share = ((self._places - start) @ way / (way @ way).clamp(min=1e-30)).clamp(0, 1)
        nearest = start + share[:, None] * way
        touched: Tensor = self._seen & ((self._places - nearest).norm(dim=1) <= radius)
        return touched

    def _tangents(self, place: Corner) -> Tensor:
        """Return x / z and y / z of the points at a place in the image, `[2]` float64."""
        c = self._camera
        x, y = (place[0] * c.width - c.cx) / c.fx, (place[1] * c.height - c.cy) / c.fy
        return torch.tensor([x, y], dtype=torch.float64)


def in_ball(means: Tensor, center: Tensor, radius: float) -> Tensor:
    """Return a mask `[N]` bool of the means within `radius`, world units, of `center`, `[3]`."""
    inside: Tensor = (means.double() - center).norm(dim=1) <= radius
    return inside


def clicked(camera: Camera, rendering: Rendering, place: Corner) -> Tensor | None:
    """Return the position `[3]`, float64, of the surface at a place in the image; None without one."""
    column = min(int(place[0] * camera.width), camera.width - 1)
    row = min(int(place[1] * camera.height), camera.height - 1)
    alpha = float(rendering.alpha.detach()[row, column])
    if alpha < _MIN_ALPHA:
        return None
    depth = float(rendering.depth.detach()[row, column]) / alpha
    u, v, z = (torch.tensor(x, dtype=torch.float64) for x in (column + 0.5, row + 0.5, depth))
    return camera.unproject(u, v, z)
