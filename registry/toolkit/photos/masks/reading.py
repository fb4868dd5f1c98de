"""Read the masks of photographs, and leave out what they exclude."""

from __future__ import annotations

import logging
from collections import Counter
from typing import TYPE_CHECKING

from ....errors import SceneError
from ..decoder import (
    EIGHT_BIT_MODES,
    QUARTER_TURNS,
    alpha_channel,
    exif_orientation,
    open_image,
    turned_by,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray
    from PIL import Image

    from ....contract.scene import PointCloud, View
    from ..decoder import Pixels, Size

_LOSSY = ("JPEG", "WEBP")
_FIX = "restore the mask, or remove it from the scene; `masks: false` ignores all"

_log = logging.getLogger("stereogs.photos")


def read_mask(
    path: Path, size: Size, *, white_only: bool = False, orientation: int = 1
) -> tuple[Pixels, str]:
    """Return a mask, `[H, W]` uint8, 255 where pixels count; between where the resized mask has an edge.

    A pixel counts if it is not black, whatever the largest value is: 0 and 1, 0 and 255, labels, colours and
    16 bits. A lossy file blurs black, so there a pixel counts from half of the largest value on. In a file
    with transparency that varies, pixels count that are not completely transparent.

    Args:
        white_only: Only pure white counts, as in DTU's masks.
        orientation: EXIF orientation by which the photograph was turned. The mask is turned too if its own
            EXIF data say so, or if it only fits the photograph then.

    Returns:
        The mask, and the rule in words; empty if the mask is just black and white.

    Raises:
        SceneError: See `open_image`; also if the mask has another shape than `size`.
    """
    import numpy as np
    from PIL import Image

    with open_image(path, "the mask", _FIX) as file:
        width, height = file.size
        turn = exif_orientation(file) if orientation != 1 else 1
        if turn == 1 and not _same_shape((width, height), size):
            turn = orientation
        if not _same_shape((height, width) if turn in QUARTER_TURNS else (width, height), size):
            raise SceneError(
                f"the mask is {width}x{height}, its photograph {size[0]}x{size[1]}, which has another shape",
                where=str(path),
                fix="make the mask from this photograph, in the same orientation",
            )
        rules = []
        if white_only:
            marked = file.convert("L")
        else:
            values, rule = _mask_values(file)
            least = values.max() / 2 if file.format in _LOSSY else 0
            marked = Image.fromarray(np.where(values > least, 255, 0).astype(np.uint8))
            rules.append(rule)
        marked = turned_by(marked, turn)
        if orientation != 1 and turn == 1:
            rules.append("taken as the photograph is shown after turning it by its EXIF data")
        same = marked.size == size
        resized = marked if same else marked.resize(size, Image.Resampling.BICUBIC)
        return np.asarray(resized), "; ".join(filter(None, rules))


def _same_shape(mask: Size, photo: Size) -> bool:
    width, height = mask
    return abs(width * photo[1] / height - photo[0]) <= max(1.0, photo[0] / width)


def _mask_values(file: Image.Image) -> tuple[NDArray[np.float64], str]:
    """Return `[H, W]`: transparency if it varies, else the largest channel; and the rule in words."""
    import numpy as np

    if file.has_transparency_data:
        alpha = np.asarray(alpha_channel(file), dtype=np.float64)
        if alpha.min() < alpha.max():
            return alpha, "pixels count that are not transparent; colours do not matter"
    colors = file.convert("RGB") if file.mode in (*EIGHT_BIT_MODES, "HSV", "LAB") else file
    values = np.asarray(colors, dtype=np.float64)
    values = values if values.ndim == 2 else values.max(axis=2)
    if file.format in _LOSSY:
        return values, f"pixels count from {values.max() / 2:g} on, because {file.format} blurs"
    if np.isin(values, (0, 255)).all():
        return values, ""
    return values, f"all pixels count but those of value 0; the largest value is {values.max():g}"


def report_masks(paths: Sequence[Path | None], views: Sequence[View], rules: Iterable[str]) -> None:
    """Log how many pixels of how many photographs train, and each rule that is not obvious."""
    for rule, count in Counter(rule for rule in rules if rule).items():
        _log.info("%d masks: %s", count, rule)
    shares = [float(view.weights.mean()) for view in views if view.weights is not None]
    if shares:
        _log.info(
            "%d of %d photographs have a mask, for example %s: black pixels, %.0f %%, neither train nor "
            "count in scores; `masks: false` uses all",
            *(len(shares), len(views), next(filter(None, paths)).name),
            100 * (1 - sum(shares) / len(shares)),
        )


def points_in_training(points: PointCloud | None, views: Sequence[View]) -> PointCloud | None:
    """Leave out points that masks exclude in each training view whose image contains them."""
    import torch

    if points is None or all(view.weights is None for view in views):
        return points
    contained, shown = torch.zeros(2, len(points), dtype=torch.bool)
    for view in views:
        u, v, z = view.camera.project(points.positions)
        there = view.camera.contains(u, v, z)
        contained |= there
        if view.weights is not None:
            there[there.clone()] = view.weights[v[there].long(), u[there].long()] > 0
        shown |= there
    kept = shown | ~contained
    if not kept.any():
        return None
    return points.subset(kept)
