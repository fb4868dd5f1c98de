"""Gaussians in Niantic's compressed format SPZ, about a sixth of a PLY's size.

Version 3 of the format (github.com/nianticlabs/spz, README, "SPZ format"): 21 bytes per Gaussian plus one per
SH coefficient above degree 0, compressed by gzip.
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

_MAGIC, _VERSION = 0x5053474E, 3
_POSITION_BITS = 24
_COLOR_SCALE = 0.15
_LOG_SCALE_OFFSET, _LOG_SCALE_STEPS = 10.0, 16.0
_SH_STEPS, _SH_MIDDLE = 128.0, 128.0
_ROTATION_STEPS = 511
"""Steps of a quaternion's component from 0 to 1 / sqrt(2)."""
_GZIP_LEVEL = 4


def spz_bytes(gaussians: Gaussians, max_fractional_bits: int = _POSITION_BITS) -> bytes:
    """Return the content of an SPZ file; deterministic.

    Positions have 24 bits, log-scales steps of 1/16 clamped to -10 .. 5.9, the smaller three components of a
    quaternion 10 bits, other parameters 8 bits. Axes are written as they are; the format's are x right, y up,
    z back.

    Args:
        gaussians: at least one, finite.
        max_fractional_bits: bits of a position behind the point, at most; fewer if the largest coordinate
            needs more before it.
    """
    means = gaussians.means.double().numpy()
    bits = min(max_fractional_bits, _fractional_bits(float(np.abs(means).max())))
    fixed = np.round(means * 2.0**bits).astype("<i4")
    opacities = gaussians.opacity_logits.sigmoid().numpy()
    colors, higher = gaussians.sh[:, 0].numpy(), gaussians.sh[:, 1:].numpy()
    parts = (
        fixed.view(np.uint8).reshape(len(fixed), 3, 4)[:, :, :3],
        _byte(opacities * 255),
        _byte((colors * _COLOR_SCALE + 0.5) * 255),
        _byte((gaussians.log_scales.numpy() + _LOG_SCALE_OFFSET) * _LOG_SCALE_STEPS),
        _smallest_three(gaussians.quaternions.double().numpy()),
        _byte(higher * _SH_STEPS + _SH_MIDDLE),
    )
    header = struct.pack("<IIIBBBB", _MAGIC, _VERSION, len(fixed), gaussians.sh_degree, bits, 0, 0)
    content = header + b"".join(part.tobytes() for part in parts)
    return gzip.compress(content, _GZIP_LEVEL, mtime=0)


def _fractional_bits(largest: float) -> int:
    """Return the most fractional bits of a signed 24-bit number that can represent `largest`."""
    return max(0, min(_POSITION_BITS, _POSITION_BITS - 1 - math.frexp(largest)[1]))


def _smallest_three(quaternions: NDArray[np.float64]) -> NDArray[np.uint32]:
    """Pack quaternions `[N, 4]` (w, x, y, z): the index of the largest component, and the other three.

    The index in (x, y, z, w) has 2 bits; the others have a sign and 9 bits each. The largest is positive and
    follows from the length of 1.
    """
    xyzw = np.roll(quaternions, -1, axis=1)
    xyzw /= np.linalg.norm(xyzw, axis=1, keepdims=True)
    largest = np.abs(xyzw).argmax(axis=1)[:, None]
    negated = np.take_along_axis(xyzw, largest, axis=1) < 0
    values = np.where(negated, -xyzw, xyzw)
    steps = np.round(np.abs(values) * math.sqrt(2) * _ROTATION_STEPS).astype("<u4")
    fields = (values < 0) * np.uint32(1 << 9) + np.minimum(steps, _ROTATION_STEPS)
    packed: NDArray[np.uint32] = largest[:, 0].astype("<u4")
    for index in range(4):
        packed = np.where(largest[:, 0] == index, packed, packed << 10 | fields[:, index])
    return packed


def _byte(values: NDArray[Any]) -> Bytes:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)
