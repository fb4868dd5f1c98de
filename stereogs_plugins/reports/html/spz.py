"""SPZ encoding: 20 bytes per Gaussian plus one per SH coefficient above degree 0, compressed by gzip.

Version 2 of Niantic's format (github.com/nianticlabs/spz, README, "SPZ format").
"""

from __future__ import annotations

import gzip
import math
import struct
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from core_rasterizer import Gaussians

    Bytes = NDArray[np.uint8]

_MAGIC, _VERSION = 0x5053474E, 2
_POSITION_BITS = 24
_COLOR_SCALE = 0.15
_LOG_SCALE_OFFSET, _LOG_SCALE_STEPS = 10.0, 16.0
_SH_STEPS, _SH_MIDDLE = 128.0, 128.0
_GZIP_LEVEL = 4


def spz(gaussians: Gaussians) -> bytes:
    """Return the file's bytes; deterministic.

    Positions have 24 bits relative to the scene's largest coordinate, log-scales steps of 1/16 clamped to
    -10 .. 5.9, other parameters 8 bits.

    Args:
        gaussians: at least one, finite.
    """
    means = gaussians.means.double().numpy()
    bits = _fractional_bits(float(np.abs(means).max()))
    fixed = np.round(means * 2.0**bits).astype("<i4")
    opacities = gaussians.opacity_logits.sigmoid().numpy()
    colors, higher = gaussians.sh[:, 0].numpy(), gaussians.sh[:, 1:].numpy()
    quaternions = gaussians.quaternions.numpy()
    quaternions = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    # Only x, y and z are stored: w = sqrt(1 - x^2 - y^2 - z^2).
    xyz = quaternions[:, 1:] * np.where(quaternions[:, :1] < 0, -1, 1)
    parts = (
        fixed.view(np.uint8).reshape(len(fixed), 3, 4)[:, :, :3],
        _byte(opacities * 255),
        _byte((colors * _COLOR_SCALE + 0.5) * 255),
        _byte((gaussians.log_scales.numpy() + _LOG_SCALE_OFFSET) * _LOG_SCALE_STEPS),
        _byte(xyz * 127.5 + 127.5),
        _byte(higher * _SH_STEPS + _SH_MIDDLE),
    )
    header = struct.pack("<IIIBBBB", _MAGIC, _VERSION, len(fixed), gaussians.sh_degree, bits, 0, 0)
    content = header + b"".join(part.tobytes() for part in parts)
    return gzip.compress(content, _GZIP_LEVEL, mtime=0)


def _fractional_bits(largest: float) -> int:
    """Return the most fractional bits of a signed 24-bit number that can represent `largest`."""
    return max(0, min(_POSITION_BITS, _POSITION_BITS - 1 - math.frexp(largest)[1]))


def _byte(values: NDArray[Any]) -> Bytes:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)
