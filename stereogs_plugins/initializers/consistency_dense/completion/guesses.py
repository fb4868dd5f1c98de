"""Guessed depths in the holes of all views, without those that other views or the background contradict."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np

from registry.toolkit.progress import in_parallel

from ..layers import is_background
from ..projection import lift, pixel_centers, pixel_of, project
from ..scene_analysis.contradictions import Evidence, miscolored
from ..visibility import in_free_space, source_indices
from .fill import fill_holes
from .planes import plane_depths

if TYPE_CHECKING:
    from collections.abc import Sequence

    from registry import TrainingScene

    from ..projection import Colors, DepthImage, Mask
    from ..scene_analysis.analysis import SceneAnalysis

MIN_CONFIRMED = 0.25
"""Least confirmed share of the completed surface; below it guesses do more harm than good.

Measured on held-out training views: with 14 % confirmed (a temple on a turntable) guesses cost 5.2 dB;
with 33 % (a toy on white) they gain 0.4 dB (benchmarks/notes.md)."""
SHOWN_COLOR_RANGE = 0.1
"""Largest difference of a channel between a point and the colours around its pixel; half of what
contradicts a point, since a point behind the visible surface often has nearly its colour."""

_log = logging.getLogger(__name__)


def guesses(
    scene: TrainingScene,
    confirmed: Sequence[DepthImage],
    analysis: SceneAnalysis,
    *,
    background_range: int,
    also_shown: bool = True,
    planes: bool = False,
) -> list[DepthImage] | None:
    """Guess the unconfirmed depths of each view; None, with a warning, if too little is confirmed.

    Args:
        confirmed: `[H, W]` for each view, 0 in holes.
        analysis: nothing is guessed on its plain background.
        background_range: 8-bit levels up to which a colour is the scene's background.
        also_shown: also guess where a confirmed point of another view with the pixel's colour falls.
        planes: continue planes where known depths lie on one, before other holes are filled.
    """
    cameras = tuple(view.camera for view in scene.train)
    sources = source_indices(cameras, scene.bounds)
    images = [view.image.numpy() for view in scene.train]
    all_evidence: list[Evidence] = []
    if analysis.wide or not also_shown:
        all_evidence = in_parallel(
            lambda index: Evidence.of(scene.train[index], confirmed[index]), range(len(images))
        )

    def filled(index: int) -> tuple[DepthImage, int]:
        """Wanted guesses, and the number of all guesses, so that `also_shown` does not affect it."""
        camera, image = cameras[index], images[index]
        if not confirmed[index].any():
            return confirmed[index].copy(), 0
        known = confirmed[index]
        flat = plane_depths(image, known) if planes else np.zeros_like(known)
        depth = flat + fill_holes(image, known + flat)
        points = lift(camera, *pixel_centers(camera), depth)
        others = sources[index]
        depth[in_free_space(points, [(cameras[k], confirmed[k]) for k in others])] = 0
        evidence = [all_evidence[k] for k in others] if all_evidence else []
        if analysis.wide:
            depth[miscolored(points, image, camera, evidence)] = 0
        depth[is_background(image, scene.background, background_range)] = 0
        depth[analysis.backgrounds[index]] = 0
        trained = scene.train[index].trained
        if trained is not None:
            depth[~trained.numpy()] = 0
        count = int((depth > 0).sum())
        if not also_shown:
            depth[shown_elsewhere(all_evidence[index], evidence, [images[k] for k in others])] = 0
        return depth, count

    found = in_parallel(filled, range(len(scene.train)), stage="completing")
    known = sum(int((depth > 0).sum()) for depth in confirmed)
    share = known / max(1, known + sum(count for _, count in found))
    if share >= MIN_CONFIRMED:
        return [depth for depth, _ in found]
    _log.warning(
        "%s: other views confirm %.0f %% of the surface, too little to guess the rest. If the photographs "
        "show the same things, check axes, unit and order of the poses (`stereogs check`). Otherwise add "
        "photographs, or take some closer to each other",
        scene.name,
        100 * share,
    )
    return None


def shown_elsewhere(view: Evidence, others: Sequence[Evidence], images: Sequence[Colors]) -> Mask:
    """Pixels `[H, W]` of a view onto which a confirmed point of another view with their colour projects.

    Args:
        images: photographs of the other views, `[H, W, 3]`.
    """
    lowest, highest = view.lowest - SHOWN_COLOR_RANGE, view.highest + SHOWN_COLOR_RANGE
    shown = np.zeros(view.depth.shape, dtype=np.bool_)
    for other, image in zip(others, images, strict=True):
        known = other.depth > 0
        points = lift(other.camera, *pixel_centers(other.camera), other.depth)[known]
        u, v, _ = project(view.camera, points)
        within, row, column = pixel_of(shown.shape, u, v)
        color = image[known]
        alike = (color >= lowest[row, column]) & (color <= highest[row, column])
        matching = within & alike.all(axis=-1)
        shown[row[matching], column[matching]] = True
    return shown
