"""Depths in holes from planes fitted to the known depths of each segment of the image.

Walls, floors and tables have little texture, so few of their depths are confirmed, but those that are lie on
a plane. In an image a plane's inverse depth is linear in the pixel position.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..projection import Colors, DepthImage, Floats, Indices, Mask

SEGMENT_SCALE = 1 / 950
"""`scale` of the segmentation relative to the number of pixels: 200 for 504x378."""
MIN_SEGMENT = 1 / 1270
"""Fewest pixels of a segment relative to the number of pixels: 150 for 504x378."""
BLUR = 0.8
"""Standard deviation of the blur before segmentation, pixels."""
MIN_KNOWN = 30
"""Fewest known depths of a segment that determine a plane."""
TOLERANCE = 0.02
"""Largest relative difference of an inverse depth from the plane."""
MIN_ON_PLANE = 0.5
"""Least share of a segment's known depths on the plane."""
REACH = 2.0
"""Guesses are at most this many times nearer or farther than nearly all known depths of the segment."""
TRIALS, SAMPLED, REFITS = 64, 1000, 3
"""Planes through three random pixels, pixels that judge them, and least squares fits to those on the best."""


def plane_depths(image: Colors, depth: DepthImage) -> DepthImage:
    """Guess the unknown depths of segments whose known depths lie on a plane; all others are 0.

    Args:
        image: `[H, W, 3]` in [0, 1].
        depth: 0 in holes.
    """
    from skimage.segmentation import felzenszwalb

    segments = felzenszwalb(
        image,
        scale=image.shape[0] * image.shape[1] * SEGMENT_SCALE,
        sigma=BLUR,
        min_size=round(image.shape[0] * image.shape[1] * MIN_SEGMENT),
    ).ravel()
    order = np.argsort(segments, kind="stable")
    flat = depth.ravel()
    guessed = np.zeros_like(flat)
    generator = np.random.default_rng(0)
    for pixels in np.split(order, np.cumsum(np.bincount(segments))[:-1]):
        known, holes = pixels[flat[pixels] > 0], pixels[flat[pixels] == 0]
        if len(known) < MIN_KNOWN or not len(holes):
            continue
        inverse = 1 / flat[known].astype(np.float64)
        plane = _plane(_terms(known, depth.shape[1]), inverse, generator)
        if plane is not None:
            continued = _terms(holes, depth.shape[1]) @ plane
            lowest, highest = np.quantile(inverse, (0.02, 0.98))
            near = (continued > lowest / REACH) & (continued < highest * REACH)
            guessed[holes[near]] = 1 / continued[near]
    return guessed.reshape(depth.shape)


def _terms(pixels: Indices, width: int) -> Floats:
    """Column, row and 1 `[P, 3]` of flat indices."""
    row, column = np.divmod(pixels, width)
    return np.stack([column, row, np.ones_like(row)], axis=1).astype(np.float64)


def _plane(terms: Floats, inverse: Floats, generator: np.random.Generator) -> Floats | None:
    """Coefficients `[3]` of the plane with the most inverse depths on it (RANSAC); None if too few are."""
    some = generator.integers(len(terms), size=SAMPLED) if len(terms) > SAMPLED else slice(None)
    drawn = generator.integers(len(terms), size=(TRIALS, 3))
    corners = terms[drawn]
    wide = np.abs(np.linalg.det(corners)) > 0.5  # twice the triangle's area, an integer
    if not wide.any():
        return None
    planes = np.linalg.solve(corners[wide], inverse[drawn[wide]][..., None])[..., 0]
    plane: Floats = planes[_on_plane(terms[some], inverse[some], planes.T).sum(axis=0).argmax()]
    for _ in range(REFITS):
        chosen = _on_plane(terms, inverse, plane)
        plane = np.linalg.lstsq(terms[chosen], inverse[chosen], rcond=None)[0]
    return plane if _on_plane(terms, inverse, plane).mean() >= MIN_ON_PLANE else None


def _on_plane(terms: Floats, inverse: Floats, planes: Floats) -> Mask:
    """Which inverse depths `[P]` lie on a plane `[3]`, or on each of `[3, K]`."""
    expected = inverse.reshape(-1, *[1] * (planes.ndim - 1))
    result: Mask = np.abs(terms @ planes - expected) < TOLERANCE * expected
    return result
