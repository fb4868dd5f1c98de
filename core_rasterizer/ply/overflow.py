"""Leave out Gaussians whose values are finite, but overflow when they are rendered in single precision."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from ..errors import PlyError
from ..gaussians import Gaussians
from ..layout import LARGEST, PARAMETERS

_LENGTH = math.sqrt(LARGEST)
"""Lengths above it have squares that overflow."""
_SHORTEST = 1e-12
"""Kernels (MIN_QUATERNION) and torch's `normalize` take shorter quaternions for zero."""
_PIXELS = 1000.0
"""Size of the scene in the picture for which scales are checked."""

_log = logging.getLogger(__name__)


def without_overflow(gaussians: Gaussians, path: Path) -> Gaussians:
    """Return the Gaussians that can be rendered, with a warning that counts the others.

    Not rendered, or in wrong colours, are: positions whose squares overflow; coefficients that may give a
    colour above `LARGEST`; scales that give an ellipse whose determinant is larger. Quaternions that are too
    short or too long to be squared become unit quaternions, and those of length 0 the identity.

    Raises:
        PlyError: none can be rendered.
    """
    count, coefficients = len(gaussians), gaussians.sh.shape[1]
    if not count:
        return gaussians
    # The squares of K basis functions add up to K / (4 pi), so their magnitudes to K / sqrt(4 pi) at most.
    largest = LARGEST * math.sqrt(4 * math.pi) / coefficients
    overflows = {
        "x, y or z": gaussians.means.abs().amax(dim=1) > _LENGTH,
        "scale_0 to scale_2": _too_large(gaussians),
        "f_dc or f_rest": gaussians.sh.abs().amax(dim=(1, 2)) > largest,
    }
    gaussians = replace(gaussians, quaternions=_squarable(gaussians.quaternions))
    broken = torch.stack(list(overflows.values())).any(dim=0)
    lost = int(broken.sum())
    if not lost:
        return gaussians
    what = ", ".join(
        f"{int(rows.sum())} in {name} (first: vertex {int(rows.int().argmax())})"
        for name, rows in overflows.items()
        if rows.any()
    )
    if lost == count:
        raise PlyError(
            f"all Gaussians overflow in single precision: {what}",
            where=str(path),
            fix="export the scene again, or train it again",
        )
    _log.warning(
        "%s: left out %d of %d Gaussians that overflow in single precision: %s; "
        "export the scene again without them",
        *(path, lost, count, what),
    )
    return Gaussians(**{name: getattr(gaussians, name)[~broken] for name in PARAMETERS})


def _too_large(gaussians: Gaussians) -> Tensor:
    """Return which Gaussians overflow, `[N]` bool, in a picture where the scene covers `_PIXELS`.

    The determinant of an ellipse is the squared product of its axes, in pixels; dilation makes the shorter
    axis about 1 or longer. A Gaussian is seen from where it or nearly the whole scene fits into the picture.
    """
    means = gaussians.means.double()
    distances = (means - means.median(dim=0).values).norm(dim=1)
    size = float(distances.kthvalue(len(distances) - len(distances) // 20).values) or 1.0
    per_pixel = ((distances + size) / _PIXELS).log()
    axes: Tensor = (gaussians.log_scales - per_pixel[:, None]).topk(2, dim=1).values
    return axes[:, 0] + axes[:, 1].clamp(min=0) > math.log(LARGEST) / 2


def _squarable(quaternions: Tensor) -> Tensor:
    """Return quaternions whose squares neither vanish nor overflow; others keep their bits."""
    magnitudes = quaternions.abs().amax(dim=1)
    odd = (magnitudes < _SHORTEST) | (magnitudes > _LENGTH)
    chosen = quaternions[odd].double()
    lengths = chosen.norm(dim=1, keepdim=True)
    unit = torch.where(lengths > 0, chosen / lengths, torch.eye(4).double()[0])
    return quaternions.index_put((odd,), unit.float())
