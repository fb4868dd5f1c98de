"""Recognize PLY files that store other values than 3D Gaussian Splatting under the same names.

Some programs store opacities instead of logits (pixelSplat, mesh2splat), standard deviations instead of their
logarithms, or colours instead of SH coefficients. Only the values tell: of trained Gaussians many logits,
logarithms and coefficients are negative.
"""

from __future__ import annotations

import logging
import math
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from ..gaussians import SH_C0
from ..layout import MAX_LOGIT

MIN_LOG_SCALE = math.log(torch.finfo(torch.float32).tiny)
"""Stands for a length of 0."""

_ENOUGH = 8
"""Fewer values are too few to conclude anything from their range."""
_SHORT = 0.1
"""If a quarter of the scales is smaller, they are lengths: of positive logarithms few are so close to 0."""
_LARGEST_PART = 0.1
"""Share of a scene's diagonal that a typical Gaussian covers at most."""
_ABOVE_ONE = 20.0
"""SH coefficients stay below it; colours up to 255 do not."""

_log = logging.getLogger(__name__)


class _Found(NamedTuple):
    """What the values of a property look like, and whether they can be nothing else."""

    what: str
    certain: bool


def read_as_parameters(
    means: Tensor, log_scales: Tensor, logits: Tensor, constant_band: Tensor, path: Path, keep: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Return log-scales, logits and the constant SH band; convert those that are stored as something else.

    A warning names what was converted, and what may be something else but is not certain.

    Args:
        means: `[N, 3]`.
        log_scales: `[N, 3]`, perhaps lengths.
        logits: `[N]`, perhaps opacities up to 1 or 255.
        constant_band: `[N, 3]`, perhaps colours up to 1 or 255.
        keep: True if the program is known to store parameters: nothing is converted, and nothing that is
            uncertain is named.
    """
    lengths = _as_lengths(log_scales, means)
    opacities = _as_opacities(logits, surely=lengths is not None and lengths.certain)
    others = [found for found in (lengths, opacities) if found]
    colors = _as_colors(constant_band, surely=any(found.certain for found in others))
    found = [one for one in (*others, colors) if one]
    doubtful = [one.what for one in found if one.certain == keep]
    converted = [one for one in found if one.certain and not keep]
    if converted:
        _log.warning(
            "%s stores %s, unlike 3DGS; they are converted",
            *(path, " and ".join(one.what for one in converted)),
        )
    if doubtful:
        _log.warning(
            "%s perhaps stores %s, but is read as logarithms, logits and SH coefficients, as in 3DGS; if the "
            "scene looks wrong, write log(length), log(p / (1 - p)) and (color - 0.5) / %.4f",
            *(path, " and ".join(doubtful), SH_C0),
        )
    if lengths in converted:
        log_scales = log_scales.clamp(min=torch.finfo(torch.float32).tiny).log()
    if opacities in converted:
        largest = 255 if logits.max() > 1 else 1
        logits = (logits.double() / largest).logit().clamp(-MAX_LOGIT, MAX_LOGIT).float()
    if colors in converted:
        largest = 255 if constant_band.max() > 1 else 1
        constant_band = (constant_band / largest - 0.5) / SH_C0
    return log_scales, logits, constant_band


def _as_lengths(scales: Tensor, means: Tensor) -> _Found | None:
    """Recognize scales that are not logarithms: none is negative, and all Gaussians would be too large."""
    if not scales.numel() or scales.min() < 0 or scales.max() == 0:
        return None
    ordered = scales.flatten().sort().values
    size = float(scales.amax(dim=1).median().exp())
    low, high = (means.sort(dim=0).values[k] for k in (len(means) // 20, -1 - len(means) // 20))
    too_large = size > _LARGEST_PART * float((high - low).norm())
    short = float(ordered[len(ordered) // 4]) < _SHORT
    return _Found("scales as lengths", len(ordered) >= _ENOUGH and (too_large or short))


def _as_opacities(logits: Tensor, *, surely: bool) -> _Found | None:
    """Recognize opacities: all are in [0, 1], and they use most of that range, or all are 1; or up to 255.

    Logits after little training are close to each other.
    """
    if not logits.numel() or logits.min() < 0 or logits.max() == 0:
        return None
    if logits.max() > 1:
        of_bytes = MAX_LOGIT < logits.max() <= 255 and _differ(logits / 255)
        return _Found("opacities up to 255", True) if of_bytes else None
    many = len(logits) >= _ENOUGH and (_differ(logits) or bool((logits == 1).all()))
    return _Found("opacities in [0, 1]", surely or many)


def _as_colors(band: Tensor, *, surely: bool) -> _Found | None:
    """Recognize colours: no channel is dark in SH, and they use most of their range."""
    if band.numel() < _ENOUGH or band.min() < 0:
        return None
    largest = float(band.max())
    if _ABOVE_ONE < largest <= 255:
        return _Found("colours up to 255", True)
    return _Found("colours up to 1", surely) if largest <= 1 and _differ(band) else None


def _differ(values: Tensor) -> bool:
    """Return whether values in [0, 1] use more than half of that range, and are not few steps."""
    return bool(values.max() - values.min() > 0.5) and len(values.unique()) >= _ENOUGH
