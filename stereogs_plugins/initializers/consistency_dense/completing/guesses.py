"""Guesses in the holes of all views, without those that something contradicts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from registry.toolkit.photos import in_parallel

from ..layers import is_background
from ..other_views import hides
from ..projection import lift, pixel_centers
from ..understanding.contradictions import Evidence, miscolored
from ..witnesses import witnesses
from .fill import fill_holes
from .shown_elsewhere import shown_elsewhere

if TYPE_CHECKING:
    from collections.abc import Sequence

    from registry import TrainingScene

    from ..projection import DepthImage
    from ..understanding.understanding import Understanding

LEAST_CONFIRMED = 0.25
"""Of the surface that would be known with guesses: with less, guesses are worth less than nothing.

Chosen on training views left out: of a temple on a turntable 14 % is confirmed, and guesses cost 5.2 dB; of
a toy before white it is 33 %, and they gain 0.4 dB (benchmarks/notes.md)."""


@dataclass(frozen=True, eq=False)
class Guesses:
    """What can be guessed.

    Args:
        depths: `[H, W]` of each view where none is confirmed, 0 where nothing is to be guessed.
        confirmed_share: how much is confirmed of what would be known with all guesses, over all views; also
            with those that are not wanted because another view shows the same.
    """

    depths: list[DepthImage]
    confirmed_share: float

    @property
    def worthwhile(self) -> bool:
        """Whether enough is confirmed to guess the rest from."""
        return self.confirmed_share >= LEAST_CONFIRMED


def guesses(
    scene: TrainingScene,
    confirmed: Sequence[DepthImage],
    shown: Understanding,
    *,
    background_range: int,
    also_shown: bool = True,
) -> Guesses:
    """Guess what no other view confirms.

    Args:
        confirmed: of each view, 0 in holes.
        shown: what the photographs show; nothing is guessed on a plain background.
        background_range: 8-bit levels up to which a colour is the background, where nothing is guessed.
        also_shown: guess also where a confirmed point of another view falls that has the pixel's colour.
    """
    cameras = [view.camera for view in scene.train]
    images = [view.image.numpy() for view in scene.train]
    asked: list[Evidence] = []
    if shown.wide or not also_shown:
        asked = in_parallel(
            lambda index: Evidence.of(scene.train[index], confirmed[index]), range(len(images))
        )

    def filled(index: int) -> tuple[DepthImage, int]:
        camera, image = cameras[index], images[index]
        if not confirmed[index].any():  # nothing to guess from
            return confirmed[index].copy(), 0
        depth = fill_holes(image, confirmed[index])
        points = lift(camera, *pixel_centers(camera), depth)
        others = witnesses(cameras, index, scene.bounds)
        depth[hides(points, [cameras[k] for k in others], [confirmed[k] for k in others])] = 0
        evidence = [asked[k] for k in others] if asked else []
        if shown.wide:
            depth[miscolored(points, image, camera, evidence)] = 0
        depth[is_background(image, scene.background, background_range)] = 0
        depth[shown.backgrounds[index]] = 0
        count = int((depth > 0).sum())
        if not also_shown:
            depth[shown_elsewhere(asked[index], evidence, [images[k] for k in others])] = 0
        return depth, count

    found = in_parallel(filled, range(len(scene.train)))
    sure = sum(int((depth > 0).sum()) for depth in confirmed)
    guessed = sum(count for _, count in found)
    return Guesses([depth for depth, _ in found], sure / max(1, sure + guessed))
