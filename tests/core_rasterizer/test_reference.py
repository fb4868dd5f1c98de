"""The reference against an independent float64 renderer, and its conventions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera, Rendering
from core_rasterizer.reference import composite, project, render, rotation_matrices
from tests.data import data_folder

INPUTS = ("means", "quaternions", "scales", "opacities", "sh")
OUTPUTS = ("rgb", "depth", "alpha")
NEAR_OF_GOLDEN = 0.01

RELATIVE_TOLERANCE = 1e-9
"""Of the largest value: both sides are float64, but sum in another order."""
PIXEL_BUDGET = 1e-4
"""Share of pixels that may differ: those that sit on a threshold to the last digits."""


@dataclass
class Golden:
    """A scene with its answer: inputs as leaves, and everything else from the file."""

    inputs: dict[str, Any]
    camera: Camera
    answer: dict[str, Tensor]


@pytest.fixture(params=["surf_3000", "garden_3000"], scope="module")
def golden(request: pytest.FixtureRequest) -> Golden:
    with np.load(Path(data_folder("golden_render")) / f"{request.param}.npz") as file:
        arrays = {name: torch.from_numpy(file[name]) for name in file.files}
    fx, fy, cx, cy = (float(arrays[name]) for name in ("fx", "fy", "cx", "cy"))
    size = (int(arrays["width"]), int(arrays["height"]))
    return Golden(
        inputs={name: arrays[name].double().requires_grad_() for name in INPUTS},
        camera=Camera(arrays["world_to_camera"], fx, fy, cx, cy, *size),
        answer=arrays,
    )


@pytest.fixture(scope="module")
def rendering(golden: Golden) -> Rendering:
    return render(**golden.inputs, camera=golden.camera, near=NEAR_OF_GOLDEN)


def share_that_differs(actual: Tensor, expected: Tensor) -> float:
    assert torch.isfinite(actual).all()
    error = (actual.detach() - expected).abs() / expected.abs().max()
    return float((error > RELATIVE_TOLERANCE).double().mean())


@pytest.mark.parametrize("output", OUTPUTS)
def test_images_agree_with_an_independent_renderer(
    golden: Golden, rendering: Rendering, output: str
) -> None:
    share = share_that_differs(getattr(rendering, output), golden.answer[output])
    assert share <= PIXEL_BUDGET


def test_gradients_agree_with_an_independent_renderer(golden: Golden, rendering: Rendering) -> None:
    loss = sum(
        (golden.answer[f"weight_{name}"].double() * getattr(rendering, name)).sum()
        for name in OUTPUTS
    )
    assert isinstance(loss, Tensor)
    gradients = torch.autograd.grad(loss, list(golden.inputs.values()))
    for name, gradient in zip(INPUTS, gradients, strict=True):
        assert share_that_differs(gradient, golden.answer[f"grad_{name}"]) <= PIXEL_BUDGET, name


def simple_camera(width: int = 32, height: int = 24, cx: float | None = None) -> Camera:
    return Camera(
        torch.eye(4), 30.0, 30.0, width / 2 if cx is None else cx, height / 2, width, height
    )


def one_gaussian(**changes: list[float]) -> dict[str, Any]:
    """A grey ball in front of the camera, its centre on the centre of pixel (16, 12)."""
    values: dict[str, list[float]] = {
        "means": [0.05, 0.05, 3.0],
        "quaternions": [1.0, 0.0, 0.0, 0.0],
        "scales": [0.2, 0.2, 0.2],
        "opacities": [0.7],
        "sh": [0.0, 0.0, 0.0],
        **changes,
    }
    tensors = {name: torch.tensor([v], dtype=torch.float64) for name, v in values.items()}
    tensors["opacities"] = tensors["opacities"][:, 0]
    tensors["sh"] = tensors["sh"].reshape(1, -1, 3)
    return {name: tensor.requires_grad_() for name, tensor in tensors.items()}


def stacked(*scenes: dict[str, Tensor]) -> dict[str, Any]:
    return {name: torch.cat([scene[name] for scene in scenes]).detach() for name in INPUTS}


def test_one_gaussian_has_the_values_of_the_formula() -> None:
    image = render(**one_gaussian(), camera=simple_camera(), background=(1.0, 0.0, 0.0))
    assert image.alpha[12, 16].item() == pytest.approx(0.7, rel=1e-12)
    assert image.depth[12, 16].item() == pytest.approx(0.7 * 3.0, rel=1e-12)
    assert image.rgb[12, 16].tolist() == pytest.approx([0.7 * 0.5 + 0.3, 0.35, 0.35], rel=1e-12)
    # One pixel to the right; seen off its axis, the ball is a little wider than 30 * 0.2 / 3.
    variance = (30 * 0.2 / 3) ** 2 * (1 + (0.05 / 3) ** 2) + 0.3
    beside = 0.7 * math.exp(-0.5 / variance)
    assert image.alpha[12, 17].item() == pytest.approx(beside, rel=1e-4)


def test_a_gaussian_reaches_the_pixels_where_alpha_is_at_least_1_over_255() -> None:
    alpha = render(**one_gaussian(), camera=simple_camera()).alpha
    touched = alpha > 0
    assert (alpha[touched] >= 1 / 255).all()
    # Beyond three standard deviations, where a clip would leave nothing.
    assert touched[12].sum() > 2 * 3 * math.sqrt(4.3)
    assert not touched.all()


def test_alpha_is_clamped_without_gradient() -> None:
    scene = one_gaussian(opacities=[0.999])
    image = render(**scene, camera=simple_camera())
    assert image.alpha[12, 16].item() == pytest.approx(0.99, rel=1e-12)
    image.alpha[12, 16].backward()
    assert scene["opacities"].grad is not None
    assert scene["opacities"].grad.item() == 0


def test_a_pixel_stops_at_the_smallest_transmittance() -> None:
    depths = [3.0 + i for i in range(6)]
    layers = [one_gaussian(means=[z / 60, z / 60, z], opacities=[0.95]) for z in depths]
    image = render(**stacked(*layers), camera=simple_camera())
    # 0.05^3 = 1.25e-4 of the light is left after three; a fourth would take it below 1e-4.
    assert 1 - image.alpha[12, 16].item() == pytest.approx(0.05**3, rel=1e-9)


def test_order_is_by_depth_and_then_by_index() -> None:
    red = one_gaussian(sh=[1.0, 0.0, 0.0])
    blue = one_gaussian(sh=[0.0, 0.0, 1.0])
    far = one_gaussian(means=[0.05, 0.05, 4.0], sh=[0.0, 1.0, 0.0])
    camera = simple_camera()
    red_first = render(**stacked(far, red, blue), camera=camera).rgb[12, 16]
    blue_first = render(**stacked(blue, red, far), camera=camera).rgb[12, 16]
    assert red_first[0] > red_first[2] > red_first[1]
    assert blue_first.tolist() == pytest.approx(red_first[[2, 1, 0]].tolist(), rel=1e-9)


@pytest.mark.parametrize(
    "changes",
    [
        {"means": [0.0, 0.0, 0.2]},
        {"means": [0.0, 0.0, 0.0]},
        {"means": [0.0, 0.0, -3.0]},
        {"opacities": [0.0039]},
        {"means": [math.nan, 0.0, 3.0]},
        {"scales": [0.2, math.inf, 0.2]},
        {"scales": [0.2, 1e200, 0.2]},
        {"quaternions": [math.nan, 0.0, 0.0, 0.0]},
        {"opacities": [math.nan]},
        {"sh": [0.0, -math.inf, 0.0]},
    ],
    ids=lambda changes: "-".join(f"{k}={v[-1]}" for k, v in changes.items()),
)
def test_invisible_gaussians_change_nothing(changes: dict[str, list[float]]) -> None:
    camera = simple_camera()
    seen, unseen = one_gaussian(), one_gaussian(**changes)
    both = {name: t.requires_grad_() for name, t in stacked(seen, unseen).items()}
    alone, together = render(**seen, camera=camera), render(**both, camera=camera)
    for output in OUTPUTS:
        assert torch.equal(getattr(alone, output), getattr(together, output))
    (together.rgb.sum() + together.depth.sum()).backward()
    for name, tensor in both.items():
        assert tensor.grad is not None
        assert torch.isfinite(tensor.grad).all(), name
        assert (tensor.grad[1] == 0).all(), name


def test_no_gaussians_give_the_background() -> None:
    scene = {name: t.detach()[:0].requires_grad_() for name, t in one_gaussian().items()}
    image = render(**scene, camera=simple_camera(), background=(0.1, 0.2, 0.3))
    assert torch.equal(image.rgb[5, 5], torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64))
    assert not image.alpha.any()
    image.rgb.sum().backward()
    assert scene["sh"].grad is not None
    assert scene["sh"].grad.shape == (0, 1, 3)


def test_quaternions_of_any_length_are_rotations() -> None:
    quaternions = torch.tensor([[0.1, -0.7, 0.2, 0.5]], dtype=torch.float64)
    lengths = torch.tensor([[1.0], [1e-30], [1e30]], dtype=torch.float64)
    rotations = rotation_matrices(quaternions * lengths)
    torch.testing.assert_close(rotations, rotations[:1].expand(3, 3, 3))
    torch.testing.assert_close(
        rotations @ rotations.transpose(1, 2), torch.eye(3, dtype=torch.float64).expand(3, 3, 3)
    )
    # A quarter turn about z takes x to y.
    quarter = rotation_matrices(torch.tensor([[1.0, 0.0, 0.0, 1.0]], dtype=torch.float64))
    torch.testing.assert_close(quarter[0, :, 0], torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64))


def test_a_zero_quaternion_is_the_identity_without_gradient() -> None:
    zero = one_gaussian(quaternions=[0.0, 0.0, 0.0, 0.0], scales=[0.3, 0.1, 0.2])
    identity = one_gaussian(scales=[0.3, 0.1, 0.2])
    image = render(**zero, camera=simple_camera())
    assert torch.equal(image.rgb, render(**identity, camera=simple_camera()).rgb)
    image.alpha.sum().backward()
    assert zero["quaternions"].grad is not None
    assert (zero["quaternions"].grad == 0).all()


@pytest.mark.parametrize("side", [-1.0, 1.0], ids=["left", "right"])
def test_off_centre_frustum_limits(side: float) -> None:
    """The linearisation stops 0.3 half widths beyond the edge, measured from the real centre."""
    camera = simple_camera(width=32, cx=6.0)
    edge = (32 - 6) / 30 if side > 0 else -6 / 30
    limit = edge + side * 0.3 * 32 / 60

    def width_of_ellipse(slope: float) -> float:
        scene = one_gaussian(means=[3.0 * slope, 0.0, 3.0])
        return float(project(**scene, camera=camera).covariances[0, 0, 0].detach())

    inside, at_limit = width_of_ellipse(limit - 0.05 * side), width_of_ellipse(limit)
    assert inside < at_limit
    assert width_of_ellipse(limit + 0.2 * side) == pytest.approx(at_limit, rel=1e-12)


def test_gradients_agree_with_finite_differences() -> None:
    generator = torch.Generator().manual_seed(7)
    camera = Camera(torch.eye(4), 6.0, 5.0, 3.5, 2.0, 6, 5)
    means = torch.tensor([[0.1, 0.0, 2.0], [-0.2, 0.1, 2.5], [1.9, 0.2, 2.2]])
    scene = (
        means.double(),
        torch.randn(3, 4, generator=generator, dtype=torch.float64),
        0.3 + 0.4 * torch.rand(3, 3, generator=generator, dtype=torch.float64),
        torch.tensor([0.6, 0.8, 0.7], dtype=torch.float64),
        0.2 * torch.randn(3, 4, 3, generator=generator, dtype=torch.float64),
    )

    def images(*tensors: Tensor) -> tuple[Tensor, ...]:
        means, quaternions, scales, opacities, sh = tensors
        image = render(
            means, quaternions, scales, opacities, sh, camera, background=(0.2, 0.1, 0.4)
        )
        return image.rgb, image.depth, image.alpha

    leaves = tuple(t.requires_grad_() for t in scene)
    assert torch.autograd.gradcheck(images, leaves, eps=1e-7, atol=1e-5, rtol=1e-4)


def test_the_screen_space_gradient_is_that_of_the_projected_centres() -> None:
    camera = simple_camera()
    projected = project(**one_gaussian(means=[0.3, -0.2, 3.0]), camera=camera)
    projected.centers.retain_grad()
    weights = torch.linspace(0, 1, camera.width, dtype=torch.float64)
    (composite(projected, camera.width, camera.height).alpha * weights).sum().backward()
    # To move right, where the weights grow, is worth the weights' slope times the whole alpha.
    assert projected.centers.grad is not None
    total = composite(projected, camera.width, camera.height).alpha.sum().item()
    slope = 1 / (camera.width - 1)
    assert projected.centers.grad[0, 0].item() == pytest.approx(slope * total, rel=0.05)
    assert abs(projected.centers.grad[0, 1].item()) < 1e-2 * slope * total
