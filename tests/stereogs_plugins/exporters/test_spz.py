from __future__ import annotations

import gzip
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from core_rasterizer import GaussianModel, Gaussians, open_device
from registry import PluginError
from registry.testing import check
from stereogs_plugins.exporters.spz import SpzExporter, half_turned
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.exporters.looking import SCENE, colorful, likeness

HALF_TURN = torch.diag(torch.tensor([1.0, -1, -1, 1], dtype=torch.float64))


def read_spz(file: Path) -> Gaussians:
    """SPZ 3 as its publisher describes it: a gzipped header of 16 bytes, then a plane per attribute."""
    content = gzip.decompress(file.read_bytes())
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
    return Gaussians(
        means=torch.from_numpy(fixed / float(1 << bits)).float(),
        log_scales=torch.from_numpy(scales.astype(np.float32)) / 16 - 10,
        quaternions=smallest_three(rotations.copy().view("<u4")[:, 0]),
        opacity_logits=torch.logit(torch.from_numpy(alphas[:, 0] / 255.0).float(), eps=1e-6),
        sh=torch.cat([constant[:, None], bands], dim=1),
    )


def smallest_three(packed: np.ndarray[tuple[int], np.dtype[np.uint32]]) -> torch.Tensor:
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


def test_half_a_turn_of_the_scene_and_of_the_camera_cancel_out() -> None:
    gaussians = colorful()
    assert likeness(gaussians, half_turned(gaussians), HALF_TURN) > 90


def test_what_is_read_back_looks_nearly_the_same(tmp_path: Path) -> None:
    """Opacities, colours and scales have 8 bits: 50.4 dB for these large, bright Gaussians."""
    pytest.importorskip("gsply")
    gaussians = colorful()
    model = GaussianModel(gaussians, open_device())
    (file,) = build(SpzExporter).export(model.reader(), SCENE, tmp_path)
    again = read_spz(file)
    assert likeness(gaussians, again, HALF_TURN) > 50
    turned = gaussians.means * torch.tensor([1.0, -1, -1])
    assert float((again.means - turned).abs().max()) <= 0.5 / 4096 + 1e-6


def test_keeps_the_contract() -> None:
    pytest.importorskip("gsply")
    check(SpzExporter)


def test_the_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsply", None)
    model = GaussianModel(colorful(3), open_device())
    with pytest.raises(PluginError, match="gsply") as caught:
        build(SpzExporter).export(model.reader(), SCENE, tmp_path)
    assert "stereogs-plugins[spz]" in caught.value.fix
    assert list(tmp_path.iterdir()) == []
