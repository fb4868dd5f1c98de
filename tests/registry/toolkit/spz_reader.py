"""A reader of SPZ files, written from their publisher's description."""

from __future__ import annotations

import gzip
import struct

import numpy as np
import torch

from core_rasterizer import Gaussians


def read_spz(data: bytes) -> tuple[Gaussians, int]:
    """SPZ 3: a gzipped header of 16 bytes, then a plane per attribute. Return also the fractional bits."""
    content = gzip.decompress(data)
    magic, version, count, degree, bits, _, _ = struct.unpack_from("<4sIIBBBB", content)
    assert (magic, version) == (b"NGSP", 3)
    planes, offset = [], 16
    for width in (9, 1, 3, 3, 4, 3 * ((degree + 1) ** 2 - 1)):
        planes.append(np.frombuffer(content, np.uint8, count * width, offset).reshape(count, width))
        offset += count * width
    assert offset == len(content)
    positions, alphas, colors, scales, rotations, rest = planes
    fixed = positions.reshape(count, 3, 3).astype(np.int32) @ np.array([1, 1 << 8, 1 << 16])
    fixed = np.where(fixed >= 1 << 23, fixed - (1 << 24), fixed)
    constant = (torch.from_numpy(colors.astype(np.float32)) / 255 - 0.5) / 0.15
    bands = (torch.from_numpy(rest.astype(np.float32)).reshape(count, -1, 3) - 128) / 128
    gaussians = Gaussians(
        means=torch.from_numpy(fixed / float(1 << bits)).float(),
        log_scales=torch.from_numpy(scales.astype(np.float32)) / 16 - 10,
        quaternions=_smallest_three(rotations.copy().view("<u4")[:, 0]),
        opacity_logits=torch.logit(torch.from_numpy(alphas[:, 0] / 255.0).float(), eps=1e-6),
        sh=torch.cat([constant[:, None], bands], dim=1),
    )
    return gaussians, bits


def _smallest_three(packed: np.ndarray[tuple[int], np.dtype[np.uint32]]) -> torch.Tensor:
    """Two bits for the largest component of (x, y, z, w); sign and 9 bits for each of the others."""
    result = np.zeros((len(packed), 4))
    for row, word in enumerate(packed.tolist()):
        largest = word >> 30
        for index in (3, 2, 1, 0):
            if index != largest:
                value = (word & 511) / 511 / 2**0.5
                result[row, index] = -value if word >> 9 & 1 else value
                word >>= 10
        result[row, largest] = max(0.0, 1 - float((result[row] ** 2).sum())) ** 0.5
    return torch.from_numpy(result[:, [3, 0, 1, 2]]).float()
