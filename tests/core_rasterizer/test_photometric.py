"""The fused loss against the same formula in torch's convolutions, and an independent SSIM."""

from __future__ import annotations

import pytest
import torch
from skimage.metrics import structural_similarity
from torch import Tensor

from core_rasterizer import Device, ExplainedError, photometric_loss


def twin(rgb: Tensor, target: Tensor, ssim_weight: float, l1_weight: float | None = None) -> Tensor:
    """L1 + D-SSIM in float64 with torch's conv2d, as 3DGS writes it."""
    offsets = torch.arange(-5, 6, dtype=torch.float64)
    window = torch.exp(-(offsets**2) / (2 * 1.5**2))
    window = window / window.sum()
    kernel = torch.outer(window, window).expand(3, 1, 11, 11)

    def windowed(image: Tensor) -> Tensor:
        return torch.nn.functional.conv2d(image, kernel, padding=5, groups=3)

    x, y = (image.double().permute(2, 0, 1)[None] for image in (rgb, target))
    mean_x, mean_y = windowed(x), windowed(y)
    variance_x, variance_y = windowed(x * x) - mean_x**2, windowed(y * y) - mean_y**2
    covariance = windowed(x * y) - mean_x * mean_y
    numerator = (2 * mean_x * mean_y + 0.01**2) * (2 * covariance + 0.03**2)
    denominator = (mean_x**2 + mean_y**2 + 0.01**2) * (variance_x + variance_y + 0.03**2)
    l1 = (x - y).abs().mean()
    l1_weight = 1 - ssim_weight if l1_weight is None else l1_weight
    return l1_weight * l1 + ssim_weight * (1 - (numerator / denominator).mean())


def images(height: int, width: int, noise: float = 0.1) -> tuple[Tensor, Tensor]:
    """A smooth picture with some texture, and a noisy copy; float64."""
    generator = torch.Generator().manual_seed(height * 1000 + width)
    x = torch.linspace(0, 3, width, dtype=torch.float64)
    y = torch.linspace(0, 2, height, dtype=torch.float64)
    ramp = 0.5 + 0.3 * torch.sin(
        x[None, :, None] * torch.tensor([3.0, 5.0, 7.0]) + y[:, None, None]
    )
    texture = torch.rand(height, width, 3, generator=generator, dtype=torch.float64)
    target = ramp + 0.1 * texture
    shift = torch.randn(height, width, 3, generator=generator, dtype=torch.float64)
    return target + noise * shift, target


SIZES = [(1, 1), (1, 40), (40, 1), (7, 2), (3, 3), (10, 10), (37, 53), (64, 48)]


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
@pytest.mark.parametrize("noise", [0.1, 1e-3])
@pytest.mark.parametrize(
    ("dtype", "value_tolerance", "gradient_tolerance"),
    # In float32 the covariance of a bright, even patch is the small difference of two large numbers.
    [(torch.float64, 1e-12, 1e-12), (torch.float32, 1e-6, 1e-5)],
    ids=["double", "float"],
)
def test_value_and_gradient_agree_with_convolutions(
    device: Device,
    size: tuple[int, int],
    noise: float,
    dtype: torch.dtype,
    value_tolerance: float,
    gradient_tolerance: float,
) -> None:
    rgb, target = (image.to(dtype) for image in images(*size, noise))
    fused, plain = rgb.clone().requires_grad_(), rgb.double().requires_grad_()
    loss = photometric_loss(fused, target, 0.2, device=device)
    expected = twin(plain, target, 0.2)
    loss.backward()
    expected.backward()
    assert loss.dtype == dtype
    assert loss.item() == pytest.approx(expected.item(), rel=value_tolerance)
    assert fused.grad is not None
    assert plain.grad is not None
    error = (fused.grad.double() - plain.grad).abs().max() / plain.grad.abs().max()
    assert error <= gradient_tolerance


@pytest.mark.parametrize("weights", [(1.0, 0.2), (0.0, 0.0), (3.0, 0.0), (0.0, 2.5)])
def test_weights_that_do_not_add_up_to_one(device: Device, weights: tuple[float, float]) -> None:
    """As in methods that add D-SSIM to an L1 of weight 1."""
    l1_weight, ssim_weight = weights
    rgb, target = images(20, 31)
    fused, plain = rgb.clone().requires_grad_(), rgb.clone().requires_grad_()
    loss = photometric_loss(fused, target, ssim_weight, l1_weight=l1_weight, device=device)
    expected = twin(plain, target, ssim_weight, l1_weight)
    loss.backward()
    expected.backward()
    torch.testing.assert_close(loss, expected, rtol=1e-12, atol=0)
    torch.testing.assert_close(fused.grad, plain.grad, rtol=1e-9, atol=1e-15)


def test_the_l1_weight_defaults_to_the_rest(device: Device) -> None:
    rgb, target = (image.float() for image in images(20, 31))
    outcomes = []
    for weights in ({}, {"l1_weight": 1 - 0.2}):
        leaf = rgb.clone().requires_grad_()
        loss = photometric_loss(leaf, target, 0.2, **weights, device=device)
        loss.backward()
        outcomes.append((loss.detach(), leaf.grad))
    for one, other in zip(*outcomes, strict=True):
        assert one is not None
        assert other is not None
        assert torch.equal(one, other)


@pytest.mark.parametrize("weight", [0.0, 0.2, 1.0])
def test_gradient_agrees_with_finite_differences(device: Device, weight: float) -> None:
    rgb, target = images(4, 3)
    assert torch.autograd.gradcheck(
        lambda image: photometric_loss(image, target, weight, device=device),
        (rgb.requires_grad_(),),
        eps=1e-6,
        atol=1e-8,
    )


def test_an_independent_ssim_agrees_inside(device: Device) -> None:
    """scikit-image treats the border in its own way, so only windows that fit are compared."""
    rgb, target = images(44, 50)
    # Outside a frame of ten pixels the images are equal, and so their SSIM there is exactly 1.
    for image in (rgb, target):
        image[:10], image[-10:], image[:, :10], image[:, -10:] = 0.5, 0.5, 0.5, 0.5
    _, map_of_ssim = structural_similarity(
        rgb.numpy(),
        target.numpy(),
        data_range=1.0,
        channel_axis=2,
        gaussian_weights=True,
        sigma=1.5,
        truncate=3.5,
        use_sample_covariance=False,
        full=True,
    )
    loss = photometric_loss(rgb, target, 1.0, device=device)
    assert 1 - loss.item() == pytest.approx(map_of_ssim.mean(), rel=1e-9)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=["double", "float"])
@pytest.mark.parametrize(
    "size", [(1, 1), (10, 10), (37, 53)], ids=lambda size: f"{size[0]}x{size[1]}"
)
def test_equal_images_lose_exactly_nothing(
    device: Device, size: tuple[int, int], dtype: torch.dtype
) -> None:
    image = images(*size)[0].to(dtype).requires_grad_()
    loss = photometric_loss(image, image.detach().clone(), device=device)
    loss.backward()
    assert loss.item() == 0.0
    assert image.grad is not None
    assert not image.grad.any()


def test_constant_images_stay_finite(device: Device) -> None:
    for level in (0.0, 1.0):
        black = torch.zeros(20, 20, 3, requires_grad=True)
        loss = photometric_loss(black, torch.full((20, 20, 3), level), device=device)
        loss.backward()
        assert black.grad is not None
        assert torch.isfinite(black.grad).all()
        assert loss.item() == pytest.approx(
            twin(black.detach(), black.detach() + level, 0.2).item()
        )


def test_losses_keep_their_gradients_apart(device: Device) -> None:
    """Two losses before one backward pass, one of them weighted: scratch memory is shared."""
    first, target = (image.float() for image in images(20, 30))
    second = first.flip(0).contiguous()
    alone = []
    for image, weight in ((first, 1.0), (second, 0.3)):
        leaf = image.clone().requires_grad_()
        (weight * photometric_loss(leaf, target, device=device)).backward()
        alone.append(leaf.grad)
    leaves = [image.clone().requires_grad_() for image in (first, second)]
    losses = [photometric_loss(leaf, target, device=device) for leaf in leaves]
    (losses[0] + 0.3 * losses[1]).backward()
    for leaf, expected in zip(leaves, alone, strict=True):
        assert leaf.grad is not None
        assert expected is not None
        assert torch.equal(leaf.grad, expected)


def test_two_runs_give_the_same_bits_and_the_inputs_may_be_views(device: Device) -> None:
    wide, target = (image.float() for image in images(60, 90))
    view, cut = wide[3:53, 5:75], target[3:53, 5:75]
    results = []
    for image in (view, view.clone(), view.flip(1).flip(1)):
        leaf = image.detach().requires_grad_()
        loss = photometric_loss(leaf, cut, device=device)
        loss.backward()
        results.append((loss.detach(), leaf.grad))
    for loss, gradient in results[1:]:
        assert torch.equal(loss, results[0][0])
        assert gradient is not None
        assert results[0][1] is not None
        assert torch.equal(gradient, results[0][1])


def test_nothing_is_differentiated_without_need(device: Device) -> None:
    rgb, target = images(12, 12)
    with torch.no_grad():
        loss = photometric_loss(rgb.requires_grad_(), target, device=device)
    assert not loss.requires_grad
    assert loss.item() == pytest.approx(twin(rgb.detach(), target, 0.2).item(), rel=1e-12)


def test_invalid_arguments_raise(device: Device) -> None:
    image = torch.zeros(4, 5, 3)
    for rgb, target in (
        (image, image[:3]),
        (image[..., :1], image[..., :1]),
        (image[:0], image[:0]),
    ):
        with pytest.raises(ExplainedError, match="shapes"):
            photometric_loss(rgb, target, device=device)
    with pytest.raises(ExplainedError, match="int32"):
        photometric_loss(image.int(), image, device=device)
    with pytest.raises(ExplainedError, match="ssim_weight"):
        photometric_loss(image, image, 1.5, device=device)
    for weights in ({"ssim_weight": -0.1}, {"ssim_weight": float("nan")}):
        with pytest.raises(ExplainedError, match="ssim_weight"):
            photometric_loss(image, image, **weights, device=device)
    for weight in (-1.0, float("inf"), float("nan")):
        with pytest.raises(ExplainedError, match="l1_weight"):
            photometric_loss(image, image, l1_weight=weight, device=device)
