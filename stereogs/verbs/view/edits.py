"""Selected and deleted Gaussians, with undo, and the PLY file that they are saved to."""

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
from registry import RunError

if TYPE_CHECKING:
    from core_rasterizer import Rendering

_MAX_UNDO = 100
_MIN_ALPHA = 0.05
"""Least alpha of a pixel that can be clicked."""

Corner = tuple[float, float]
"""A position in the image: 0 to 1 from left to right and from top to bottom."""


@dataclass(frozen=True, eq=False)
class Source:
    """Gaussians as their file holds them.

    Args:
        path: the PLY file; edited ones are written next to it.
        gaussians: returns the Gaussians in the file's coordinates, in the order of the viewer's.
        attributes: further numbers of each Gaussian, `[N]` by name.
    """

    path: Path
    gaussians: Callable[[], Gaussians]
    attributes: Mapping[str, Tensor]

    def save(self, kept: Tensor) -> Path:
        """Write Gaussians to a new file and return its path.

        Args:
            kept: mask `[N]` bool.

        Raises:
            RunError: none is kept.
            PlyError: the file cannot be written.
        """
        if not kept.any():
            raise RunError("all Gaussians are deleted", fix="press Undo")
        whole = self.gaussians()
        part = Gaussians(**{name: values[kept] for name, values in vars(whole).items()})
        path = next(path for path in map(self._numbered, count(1)) if not path.exists())
        path.parent.mkdir(parents=True, exist_ok=True)
        save_ply(part, path, {name: values[kept] for name, values in self.attributes.items()})
        return path

    def _numbered(self, number: int) -> Path:
        suffix = "" if number == 1 else f"-{number}"
        return self.path.with_name(f"{self.path.stem}-edited{suffix}.ply")


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

    def select(self, mask: Tensor, *, add: bool) -> None:
        """Add Gaussians to the selection, or remove them from it."""
        self._change(self.selected | mask if add else self.selected & ~mask, self.deleted)

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

    def _change(self, selected: Tensor, deleted: Tensor) -> None:
        selected = selected & ~deleted
        if not (selected.equal(self.selected) and deleted.equal(self.deleted)):
            self._before.append((self.selected, self.deleted))
            self.selected, self.deleted = selected, deleted
            self.revision += 1


def in_rectangle(means: Tensor, camera: Camera, low: Corner, high: Corner) -> Tensor:
    """Return a mask `[N]` bool of the means in front of a camera whose projections are in a rectangle."""
    u, v, z = camera.project(means)
    x, y = u / camera.width, v / camera.height
    return (z > 0) & (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])


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
