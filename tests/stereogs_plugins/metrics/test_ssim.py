from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.ndimage import correlate  # type: ignore[attr-defined]
from torch import Tensor

from core_rasterizer import photometric_loss
from stereogs_plugins.metrics.ssim import SSIM, stereogs_register_metrics
from tests.stereogs_plugins.building import build, offered


def images() -> Tensor:
    generator = torch.Generator().manual_seed(3)
    first = torch.rand(24, 31, 3, generator=generator)
    noise = torch.rand(24, 31, 3, generator=generator)
    return torch.stack([first, 0.7 * first + 0.3 * noise])


def plain_ssim(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """The definition in a two-dimensional filter of scipy's, channel by channel."""
    offset = np.arange(-5, 6)
    window = np.exp(-(offset[:, None] ** 2 + offset**2) / (2 * 1.5**2))
    window /= window.sum()

    def blur(plane: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(correlate(plane, window, mode="constant"))

    channels = []
    for x, y in zip(np.moveaxis(first, -1, 0), np.moveaxis(second, -1, 0), strict=True):
        mean_x, mean_y = blur(x), blur(y)
        structure = 2 * (blur(x * y) - mean_x * mean_y) + 0.0009
        spread = blur(x * x) - mean_x**2 + blur(y * y) - mean_y**2 + 0.0009
        luminance = (2 * mean_x * mean_y + 0.0001) / (mean_x**2 + mean_y**2 + 0.0001)
        channels.append(luminance * structure / spread)
    return float(np.mean(channels))


def test_is_offered_as_ssim() -> None:
    assert offered(stereogs_register_metrics) == {"ssim": SSIM}


def test_agrees_with_an_independent_implementation() -> None:
    first, second = images()
    expected = plain_ssim(first.double().numpy(), second.double().numpy())
    assert 0.5 < expected < 0.98
    assert build(SSIM).measure(first, second, None) == pytest.approx(expected, abs=1e-10)


def test_bands_of_rows_do_not_change_it(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = images()
    mask = first[..., 0] > 0.1
    whole = [build(SSIM).measure(first, second, outside) for outside in (None, mask)]
    monkeypatch.setattr("registry.toolkit.images._BAND", 31 * 7)
    bands = [build(SSIM).measure(first, second, outside) for outside in (None, mask)]
    assert bands == pytest.approx(whole, abs=1e-12)


def test_is_the_ssim_of_the_training_loss() -> None:
    first, second = images()
    loss = float(photometric_loss(first, second, ssim_weight=1.0))
    assert build(SSIM).measure(first, second, None) == pytest.approx(1 - loss, abs=1e-5)


def test_equal_images_score_one() -> None:
    first, _ = images()
    assert build(SSIM).measure(first, first, None) == pytest.approx(1, abs=1e-12)


def test_what_lies_outside_the_mask_is_white_in_both() -> None:
    first, second = images()
    mask = torch.zeros(24, 31, dtype=torch.bool)
    mask[4:12, 6:20] = True
    changed = second.clone()
    changed[20:] = 0.123
    score = build(SSIM).measure(first, second, mask)
    assert build(SSIM).measure(first, changed, mask) == score
    white = [
        image.where(mask[..., None], torch.ones(1)).double().numpy() for image in (first, second)
    ]
    assert score == pytest.approx(plain_ssim(*white), abs=1e-10)


def test_png8_compares_what_a_png_would_hold() -> None:
    first, noise = torch.rand(2, 20, 26, 3, generator=torch.Generator().manual_seed(1))
    second = 0.9 * first + 0.1 * noise
    stored = [(image.double() * 255).round() / 255 for image in (first, second)]
    score = build(SSIM, quantize="png8").measure(first, second, None)
    assert score == pytest.approx(build(SSIM).measure(stored[0], stored[1], None), abs=1e-12)
    assert score != build(SSIM).measure(first, second, None)
