from __future__ import annotations

import torch
from torch.nn.functional import normalize

from core_rasterizer import Gaussians
from registry.toolkit import spz_bytes
from tests.registry.toolkit.spz_reader import read_spz


def test_every_parameter_is_read_back_to_its_step() -> None:
    draw = torch.Generator().manual_seed(0)
    means, scales, quaternions, logits, sh = (
        torch.randn(50, *shape, generator=draw) for shape in ((3,), (3,), (4,), (), (4, 3))
    )
    gaussians = Gaussians(3 * means, scales - 3, quaternions, logits, 0.3 * sh)
    again, bits = read_spz(spz_bytes(gaussians))
    assert 2**22 <= float(gaussians.means.abs().max()) * 2**bits < 2**23, "all 24 bits are used"
    turned = (again.quaternions * normalize(quaternions, dim=1)).sum(dim=1).abs()
    assert float(turned.min()) > 1 - 1e-5, "the angle of a quaternion, or of its negative, is 0"
    for found, values, step in (
        (again.means, gaussians.means, 2.0**-bits),
        (again.log_scales, gaussians.log_scales, 1 / 16),
        (again.opacity_logits.sigmoid(), logits.sigmoid(), 1 / 255),
        (again.sh[:, 0], gaussians.sh[:, 0], 1 / 255 / 0.15),
        (again.sh[:, 1:], gaussians.sh[:, 1:], 1 / 128),
    ):
        torch.testing.assert_close(found, values, atol=step / 2 + 1e-5, rtol=0)


def test_a_far_gaussian_takes_bits_behind_the_point() -> None:
    far = torch.tensor([[-5000.0, 0, 0], [0, 0, 1]])
    alike = torch.zeros(2, 3), torch.ones(2, 4), torch.zeros(2), torch.zeros(2, 1, 3)
    again, bits = read_spz(spz_bytes(Gaussians(far, *alike), max_fractional_bits=12))
    assert bits == 10
    assert torch.equal(again.means, far)
