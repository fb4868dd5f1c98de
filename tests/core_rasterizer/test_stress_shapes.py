"""Scales and rotations at their limits: giants, needles, discs, specks, odd quaternions."""

from __future__ import annotations

import pytest
import torch

from core_rasterizer import Device
from tests.core_rasterizer.stress import (
    assert_agrees_with_oracle,
    assert_invisible,
    crowd,
    plain_camera,
    there_and_back,
)

TURNED = torch.tensor([0.9, 0.2, -0.3, 0.25])
"""A rotation about no axis in particular."""
DIAGONAL = torch.tensor([0.9239, 0.0, 0.0, 0.3827])
"""45 degrees about the viewing axis."""


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("scale", [1e2, 1e4, 1e6])
def test_a_giant_that_covers_every_tile(device: Device, scale: float, dtype: torch.dtype) -> None:
    """Case 4: far larger than the frame, in an image of many tiles with a ragged edge."""
    camera = plain_camera(70, 41, focal=60)
    scene = crowd()
    scene.scales[0] = scale
    scene.opacities[0] = 0.3
    assert_agrees_with_oracle(scene, camera, device, dtype)


@pytest.mark.parametrize("scale", [1e17, 1e30])
def test_a_giant_that_overflows_is_invisible(device: Device, scale: float) -> None:
    """Case 4 at its end: the determinant of the ellipse is no float any more."""
    scene = crowd()
    scene.scales[0] = scale
    assert_invisible(scene, 0, plain_camera(), device)


@pytest.mark.parametrize("length", [1e-20, 1e-6, 1e6, 1e20])
def test_quaternions_of_any_length(device: Device, length: float) -> None:
    """Case 6: the image does not depend on the length; the gradient is across q and goes as 1 / |q|."""
    unit, scaled = crowd(), crowd()
    unit.quaternions = torch.nn.functional.normalize(unit.quaternions, dim=1)
    is_zero = length < 1e-12
    scaled.quaternions = unit.quaternions * length
    if is_zero:  # as good as zero, which stands for the identity
        unit.quaternions[:] = torch.tensor([1.0, 0.0, 0.0, 0.0])
    camera = plain_camera()
    expected, expected_gradients = there_and_back(unit, camera, device)
    rendering, gradients = there_and_back(scaled, camera, device)
    torch.testing.assert_close(rendering.rgb, expected.rgb, rtol=0, atol=2e-6)
    if is_zero:
        assert not gradients["quaternions"].any()
        return
    largest = expected_gradients["quaternions"].abs().max()
    for wanted, gradient in ((unit, expected_gradients), (scaled, gradients)):
        size = 1 if wanted is unit else length
        across = (gradient["quaternions"].double() * size * unit.quaternions).sum(dim=1)
        assert across.abs().max() < 1e-5 * largest
    torch.testing.assert_close(
        gradients["quaternions"] * length,
        expected_gradients["quaternions"],
        rtol=0,
        atol=1e-4 * float(largest),
    )


@pytest.mark.parametrize(
    "scales",
    [
        pytest.param((10.0, 1e-6, 1e-6), id="needle"),
        pytest.param((2.0, 2.0, 0.0), id="flat-disc"),
        pytest.param((1e-12, 1e-12, 1e-12), id="speck"),
        pytest.param((0.0, 0.0, 0.0), id="point"),
        pytest.param((1e-40, 0.1, 0.1), id="denormal"),
    ],
)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_degenerate_shapes(
    device: Device, scales: tuple[float, float, float], dtype: torch.dtype
) -> None:
    """Case 9: one or more axes vanish. The dilation keeps the ellipse an ellipse.

    In float a needle's rotation is known to the precision times the square of its length in pixels.
    """
    scene = crowd()
    scene.scales[0] = torch.tensor(scales)
    scene.quaternions[0] = TURNED
    assert_agrees_with_oracle(
        scene, plain_camera(), device, dtype, image_tolerance=2e-5, gradient_tolerance=3e-2
    )


@pytest.mark.parametrize(("length", "gradient_tolerance"), [(200.0, 1e-5), (2e4, 1e-2)])
def test_a_determinant_that_cancels(
    device: Device, length: float, gradient_tolerance: float
) -> None:
    """Case 10: a diagonal needle of covariance 1e8 px² and far more, correlation all but 1.

    xx yy - xy² would lose every digit and turn negative; the needle must still be drawn thin.
    """
    scene = crowd()
    scene.scales[0] = torch.tensor([length, 1e-4, 1e-4])
    scene.quaternions[0] = DIAGONAL
    camera = plain_camera(64, 64)
    there_and_back(scene, camera, device)
    assert_agrees_with_oracle(scene, camera, device, torch.float64, 1e-6, gradient_tolerance)
    alone = crowd(1)
    alone.scales[0], alone.quaternions[0] = scene.scales[0], scene.quaternions[0]
    rendering, _ = there_and_back(alone, camera, device)
    touched = int(rendering.alpha.count_nonzero())
    assert 64 <= touched <= 6 * 64, "a line across the image, a few pixels wide"


@pytest.mark.parametrize("copies", [2, 300])
def test_many_gaussians_at_one_place(device: Device, copies: int) -> None:
    """Case 21: exact duplicates, as a cloud with doubled points starts out."""
    scene = crowd(1)
    for name, values in vars(scene).items():
        setattr(scene, name, values.repeat_interleave(copies, dim=0))
    scene.opacities[:] = 0.02
    assert_agrees_with_oracle(scene, plain_camera(), device)
