from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from stereogs_plugins.metrics.ssim_skimage import ScikitImageSSIM, stereogs_register_metrics
from tests.stereogs_plugins.building import build, offered


def plain_ssim(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Uniform 7x7 windows that lie inside the image, sample covariances."""
    x, y = (sliding_window_view(image, (7, 7), axis=(0, 1)) for image in (first, second))
    x, y = x.reshape(*x.shape[:3], 49), y.reshape(*y.shape[:3], 49)
    mean_x, mean_y = x.mean(-1), y.mean(-1)
    covariance = ((x - mean_x[..., None]) * (y - mean_y[..., None])).sum(-1) / 48
    spread = x.var(-1, ddof=1) + y.var(-1, ddof=1)
    return float(
        np.mean(
            (2 * mean_x * mean_y + 1e-4)
            * (2 * covariance + 9e-4)
            / ((mean_x**2 + mean_y**2 + 1e-4) * (spread + 9e-4))
        )
    )


def test_is_offered_as_ssim_skimage() -> None:
    assert offered(stereogs_register_metrics) == {"ssim_skimage": ScikitImageSSIM}


def test_is_the_definition_of_the_nerf_literature() -> None:
    first, noise = torch.rand(2, 20, 26, 3, generator=torch.Generator().manual_seed(1))
    second = 0.6 * first + 0.4 * noise
    expected = plain_ssim(first.double().numpy(), second.double().numpy())
    score = build(ScikitImageSSIM).measure(first, second, None)
    assert score == pytest.approx(expected, abs=1e-9)


def test_what_lies_outside_the_mask_does_not_matter() -> None:
    first, second = torch.rand(2, 20, 26, 3, generator=torch.Generator().manual_seed(1))
    mask = torch.zeros(20, 26, dtype=torch.bool)
    mask[:9] = True
    changed = second.clone()
    changed[12:] = 0
    metric = build(ScikitImageSSIM)
    assert metric.measure(first, second, mask) == metric.measure(first, changed, mask)
    assert metric.measure(first, second, mask) != metric.measure(first, second, None)


def test_png8_compares_what_a_png_would_hold() -> None:
    first, noise = torch.rand(2, 20, 26, 3, generator=torch.Generator().manual_seed(1))
    second = 0.9 * first + 0.1 * noise
    stored = [(image.double() * 255).round() / 255 for image in (first, second)]
    score = build(ScikitImageSSIM, quantize="png8").measure(first, second, None)
    assert score == pytest.approx(
        build(ScikitImageSSIM).measure(stored[0], stored[1], None), abs=1e-12
    )
    assert score != build(ScikitImageSSIM).measure(first, second, None)
