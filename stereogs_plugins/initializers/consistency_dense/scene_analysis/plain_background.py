"""Plain background: areas of one colour, without texture, that reach the border of the photographs.

Nothing can be matched there, so depths agree only by chance. An area counts if its colour is at the borders
of most views. Plain areas inside an object do not count: areas grow from the image border inwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from ..image_filters import lowest_and_highest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from registry import TrainingView

    from ..projection import Colors, DepthImage, Mask

TRANSPARENT = 0.02
"""Alpha below which a pixel does not show the object."""
FLAT_WINDOW, FLAT_RANGE = 5, 16 / 255
"""A pixel is flat if each channel varies by less than the range in a square window of this width."""
COLOR_RANGE = 16 / 255
"""Largest difference of each channel from the background's colour."""
RING = 0.02
"""Width of the image border relative to the shorter side."""
MIN_RING = 0.2
"""Least share of a view's border that its background colour fills."""
MAX_COLORS = 2
"""Number of background colours: table and backdrop."""
MAX_CONFIRMED = 0.3
"""Largest confirmed share of an area; where views agree on more, it is a surface that can be matched."""


@dataclass(frozen=True, eq=False)
class PlainAreas:
    """Candidates for plain background; depths decide which of them count.

    Args:
        by_color: for each colour the area `[H, W]` of each view.
        transparent: `[H, W]` for each view with `alpha`, None for others.
    """

    by_color: tuple[tuple[Mask, ...], ...]
    transparent: tuple[Mask | None, ...]

    @classmethod
    def of(cls, views: Sequence[TrainingView]) -> Self:
        """Find the areas in the pixels of the photographs that train."""
        images = [view.image.numpy() for view in views]
        flats = [_flat(image) for image in images]
        trained = [None if v.trained is None else v.trained.numpy() for v in views]
        flats = [f if t is None else f & t for f, t in zip(flats, trained, strict=True)]
        transparent = [None if v.alpha is None else v.alpha.numpy() < TRANSPARENT for v in views]
        return cls(
            tuple(
                tuple(_area(image, flat, color) for image, flat in zip(images, flats, strict=True))
                for color in _border_colors(images, flats)
            ),
            tuple(
                t if t is None or known is None else t & known
                for t, known in zip(transparent, trained, strict=True)
            ),
        )

    def backgrounds(self, confirmed: Sequence[DepthImage]) -> list[Mask]:
        """For each view, the pixels `[H, W]` that show plain background.

        If a view has `alpha`, these are its transparent pixels.

        Args:
            confirmed: `[H, W]` confirmed depths of each view, 0 elsewhere.
        """
        masks: list[Mask] = [np.zeros(depth.shape, dtype=np.bool_) for depth in confirmed]
        for areas in self.by_color:
            pixels = sum(int(area.sum()) for area in areas)
            matched = sum(int((d[a] > 0).sum()) for d, a in zip(confirmed, areas, strict=True))
            if matched < MAX_CONFIRMED * pixels:
                masks = [mask | area for mask, area in zip(masks, areas, strict=True)]
        return [
            mask if transparent is None else transparent
            for transparent, mask in zip(self.transparent, masks, strict=True)
        ]


def _flat(image: Colors) -> Mask:
    lowest, highest = lowest_and_highest(image, FLAT_WINDOW)
    flat: Mask = np.asarray((highest - lowest < FLAT_RANGE).all(axis=-1))
    return flat


def _border_colors(images: Sequence[Colors], flats: Sequence[Mask]) -> list[Colors]:
    """Colours `[3]` that fill much of the border of at least half of the views, most frequent first."""
    rings = []
    for image, flat in zip(images, flats, strict=True):
        ring = _ring(flat.shape)
        rings.append((image[ring], flat[ring]))
    left = [flat.copy() for _, flat in rings]
    colors = []
    for _ in range(MAX_COLORS):
        candidates = np.concatenate([c[free] for (c, _), free in zip(rings, left, strict=True)])
        if not len(candidates):
            break
        color = _mode(candidates)
        like = [_alike(c, color) & free for (c, _), free in zip(rings, left, strict=True)]
        if np.median([part.mean() for part in like]) < MIN_RING:
            break
        colors.append(color)
        left = [free & ~part for free, part in zip(left, like, strict=True)]
    return colors


def _ring(shape: tuple[int, ...]) -> Mask:
    width = max(1, round(RING * min(shape)))
    ring = np.ones(shape, dtype=np.bool_)
    ring[width:-width, width:-width] = False
    return ring


def _mode(colors: Colors) -> Colors:
    """Median of the colours `[P, 3]` around the fullest cell of a grid over them."""
    cells = np.floor(colors / COLOR_RANGE).astype(np.int64)
    places, counts = np.unique(cells, axis=0, return_counts=True)
    fullest = (places[np.argmax(counts)] + 0.5) * COLOR_RANGE
    near = _alike(colors, fullest.astype(np.float32))
    return np.median(colors[near], axis=0).astype(np.float32)


def _alike(colors: Colors, color: Colors) -> Mask:
    alike: Mask = (np.abs(colors - color) < COLOR_RANGE).all(axis=-1)
    return alike


def _area(image: Colors, flat: Mask, color: Colors) -> Mask:
    """Flat pixels of a colour that are connected to the image border."""
    import cv2

    _, labels = cv2.connectedComponents(
        (flat & _alike(image, color)).view(np.uint8), connectivity=4
    )
    at_border = np.unique(labels[_ring(flat.shape)])
    area: Mask = np.isin(labels, at_border[at_border > 0])
    return area
