from __future__ import annotations

import math

import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio

from registry import SceneError
from stereogs_plugins.metrics.psnr import PSNR, stereogs_register_metrics
from tests.stereogs_plugins.building import build, offered


def test_is_offered_as_psnr() -> None:
    assert offered(stereogs_register_metrics) == {"psnr": PSNR}


def test_agrees_with_scikit_image() -> None:
    first, second = torch.rand(2, 20, 30, 3, generator=torch.Generator().manual_seed(0))
    expected = peak_signal_noise_ratio(
        first.double().numpy(), second.double().numpy(), data_range=1
    )
    assert build(PSNR).measure(first, second, None) == pytest.approx(expected, abs=1e-9)


def test_bands_of_rows_do_not_change_it(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = torch.rand(2, 20, 30, 3, generator=torch.Generator().manual_seed(0))
    mask = first[..., 0] > 0.9
    mask[8:13] = False
    whole = [build(PSNR).measure(first, second, inside) for inside in (None, mask)]
    monkeypatch.setattr("registry.toolkit.images._BAND", 30 * 3)
    bands = [build(PSNR).measure(first, second, inside) for inside in (None, mask)]
    assert bands == pytest.approx(whole, abs=1e-12)


def test_counts_masked_pixels_only() -> None:
    photograph = torch.zeros(4, 4, 3)
    rendered = torch.full((4, 4, 3), 0.1)
    rendered[0, 0] = 1.0
    mask = torch.ones(4, 4, dtype=torch.bool)
    mask[0, 0] = False
    assert build(PSNR).measure(rendered, photograph, mask) == pytest.approx(20, abs=1e-5)
    assert build(PSNR).measure(rendered, photograph, None) < 12


def test_equal_images_score_a_hundred() -> None:
    assert build(PSNR).measure(torch.ones(4, 4, 3), torch.ones(4, 4, 3), None) == 100


def test_png8_compares_what_a_png_would_hold() -> None:
    rendered = torch.full((4, 4, 3), 100.4 / 255)
    photograph = torch.full((4, 4, 3), 100.6 / 255)
    one_level = 20 * math.log10(255)
    metric = build(PSNR, quantize="png8")
    assert metric.measure(rendered, photograph, None) == pytest.approx(one_level, abs=1e-9)
    assert metric.measure(rendered, torch.full((4, 4, 3), 99.6 / 255), None) == 100
    assert build(PSNR).measure(rendered, photograph, None) > one_level + 13


def test_png8_rounds_half_a_level_up() -> None:
    rendered, photograph = torch.full((2, 4, 4, 3), 0.5).double()
    photograph[:] = 128 / 255
    assert build(PSNR, quantize="png8").measure(rendered, photograph, None) == 100


def test_an_empty_mask_is_explained() -> None:
    image = torch.zeros(4, 4, 3)
    with pytest.raises(SceneError, match="mask is empty"):
        build(PSNR).measure(image, image, torch.zeros(4, 4, dtype=torch.bool))
