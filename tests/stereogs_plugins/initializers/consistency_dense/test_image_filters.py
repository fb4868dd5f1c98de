"""Filters compared with scipy.ndimage."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from scipy.ndimage import (  # type: ignore[attr-defined]
    gaussian_filter,
    maximum_filter,
    minimum_filter,
)

from stereogs_plugins.initializers.consistency_dense.image_filters import (
    blurred,
    lowest_and_highest,
)

IMAGE = np.random.default_rng(0).random((37, 50, 3)).astype(np.float32)


@pytest.mark.parametrize(("outside", "mode"), [("mirrored", "reflect"), ("border", "nearest")])
@pytest.mark.parametrize("sigma", [1.0, 7.0])
def test_blur(outside: Literal["mirrored", "border"], mode: str, sigma: float) -> None:
    expected = gaussian_filter(IMAGE, (sigma, sigma, 0), mode=mode)
    np.testing.assert_allclose(blurred(IMAGE, sigma, outside=outside), expected, rtol=1e-6)


@pytest.mark.parametrize("window", [5, 7])
def test_lowest_and_highest(window: int) -> None:
    lowest, highest = lowest_and_highest(IMAGE, window)
    np.testing.assert_array_equal(lowest, minimum_filter(IMAGE, (window, window, 1)))
    np.testing.assert_array_equal(highest, maximum_filter(IMAGE, (window, window, 1)))
