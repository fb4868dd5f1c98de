"""`Rendering.visible`, also after later renders."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from core_rasterizer import (
    Camera,
    Device,
    ExplainedError,
    GaussianModel,
    Gaussians,
    Rendering,
    rasterize,
)
from tests.core_rasterizer.scenes import activated, parameters, view

CAMERA = Camera(torch.eye(4), 40, 40, 16, 16, 32, 32)


def five() -> Gaussians:
    """In view, behind the camera, outside the image, fainter than 1/255, and hidden by the first."""
    return Gaussians.from_points(
        torch.tensor([[0.0, 0, 2], [0, 0, -2], [9, 0, 2], [0, 0, 2.5], [0, 0, 3]]),
        torch.full((5, 3), 0.5),
        torch.tensor([5.0, 0.05, 0.05, 0.05, 0.05]),
        torch.tensor([0.999999, 0.5, 0.5, 0.0039, 0.5]),
        0,
    )


def seen(model: GaussianModel, camera: Camera) -> Tensor:
    with torch.no_grad():
        return model.render(camera).visible


def test_what_is_visible_and_what_is_not(device: Device) -> None:
    gaussians = five()
    expected = [True, False, False, False, True]
    rendering = GaussianModel(gaussians, device).render(CAMERA)
    assert rendering.visible.dtype == torch.bool
    assert rendering.visible.tolist() == expected
    plain = rasterize(*activated(gaussians, torch.float32), CAMERA, device=device)
    assert plain.visible.tolist() == expected


def test_whoever_has_a_gradient_is_visible(device: Device) -> None:
    model = GaussianModel(parameters(300), device)
    rendering = model.render(view())
    rendering.rgb.square().sum().backward()
    visible = rendering.visible
    assert not (model.touched() & ~visible).any()
    assert 0 < visible.sum() < 300


@pytest.mark.parametrize("gradient", [True, False])
def test_it_stays_right_when_frames_are_used_again(device: Device, gradient: bool) -> None:
    model = GaussianModel(parameters(300), device)
    expected = [seen(model, view(seed)) for seed in range(4)]
    assert not all(torch.equal(expected[0], other) for other in expected[1:])
    with torch.set_grad_enabled(gradient):
        renderings = [model.render(view(seed)) for seed in range(4)]
    # Copies without the graph, which alone keeps a frame from being used again.
    copies = [replace(each, rgb=each.rgb.detach().clamp(0, 1)) for each in renderings]
    if gradient:
        torch.stack([each.rgb.sum() for each in renderings]).sum().backward()
    bare = [replace(each, depth=each.rgb, alpha=each.rgb) for each in copies]
    del renderings, copies
    later = [model.render(view(seed)) for seed in range(4)]
    model.adopt(model.parameters.read()[:, :16].clone(), 16)
    seen(model, view(7))
    for each, other, truth in zip(bare, later, expected, strict=True):
        assert torch.equal(each.visible, truth)
        assert torch.equal(each.visible, truth)
        assert torch.equal(other.visible, truth)


def test_frames_are_used_again_where_nobody_asks(device: Device) -> None:
    model = GaussianModel(parameters(50), device)
    for _ in range(3):
        model.render(view()).rgb.sum().backward()
    assert len(model.renderer._frames) == 1
    array = model.renderer._frames[0].arrays["slot_count"]
    seen(model, view(1))
    assert model.renderer._frames[0].arrays["slot_count"] is array


def test_nothing_is_read_before_it_is_asked_for(device: Device) -> None:
    discrete = device.as_discrete()
    model = GaussianModel(parameters(100), discrete)
    model.render(view())
    before = discrete.bytes_moved
    rendering = model.render(view())
    moved = discrete.bytes_moved - before
    assert moved < 1000
    assert rendering.visible.any()
    assert discrete.bytes_moved - before - moved == 4 * 100


def test_a_rendering_made_by_hand_says_that_it_does_not_know() -> None:
    image = torch.zeros(2, 2)
    rendering = Rendering(torch.zeros(2, 2, 3), image, image)
    with pytest.raises(ExplainedError, match="are unknown") as error:
        _ = rendering.visible
    assert error.value.fix
