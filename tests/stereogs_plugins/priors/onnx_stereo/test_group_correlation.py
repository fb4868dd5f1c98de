"""The correlation volume against its definition, element by element."""

from __future__ import annotations

import pytest
import torch

from stereogs_plugins.priors.onnx_stereo.networks import group_correlation


@pytest.mark.parametrize("normalized", [False, True])
@pytest.mark.parametrize("candidates", [3, 9])
def test_every_element_is_the_product_of_one_group(normalized: bool, candidates: int) -> None:
    generator = torch.Generator().manual_seed(2)
    left, right = (torch.randn(2, 6, 2, 5, generator=generator) for _ in range(2))
    volume = group_correlation(left, right, groups=3, candidates=candidates, normalized=normalized)
    assert volume.shape == (2, 3, candidates, 2, 5)
    for item, group, shift, y, x in torch.cartesian_prod(
        *(torch.arange(size) for size in volume.shape)
    ).tolist():
        expected = torch.tensor(0.0)
        if x >= shift:
            a = left[item, 2 * group : 2 * group + 2, y, x]
            b = right[item, 2 * group : 2 * group + 2, y, x - shift]
            expected = a @ b / (a.norm() * b.norm() if normalized else 1)
        assert torch.allclose(volume[item, group, shift, y, x], expected, atol=1e-6)


def test_zero_features_have_zero_correlation() -> None:
    nothing = torch.zeros(1, 4, 2, 3)
    volume = group_correlation(nothing, nothing, groups=2, candidates=2, normalized=True)
    assert torch.equal(volume, torch.zeros(1, 2, 2, 2, 3))
