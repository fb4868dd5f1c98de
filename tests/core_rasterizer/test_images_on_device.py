"""Images stay on the device until they are accessed, with the same results."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

import core_rasterizer
from core_rasterizer import (
    Device,
    ExplainedError,
    GaussianModel,
    Rendering,
    open_device,
    photometric_loss,
)
from tests.core_rasterizer.scenes import gradients_of, parameters, random_camera
from tests.core_rasterizer.traffic import counted

WIDTH, HEIGHT = 40, 28
COLORS = 4 * 3 * WIDTH * HEIGHT


@pytest.fixture(params=[True, False], ids=["shared", "discrete"])
def model(device: Device, request: pytest.FixtureRequest) -> GaussianModel:
    return GaussianModel(parameters(60), device if request.param else device.as_discrete())


def view(seed: int = 0) -> core_rasterizer.Camera:
    return random_camera(torch.Generator().manual_seed(seed), WIDTH, HEIGHT)


def target(seed: int = 0) -> torch.Tensor:
    return torch.rand(HEIGHT, WIDTH, 3, generator=torch.Generator().manual_seed(seed))


def test_images_are_copied_on_first_access(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    model = GaussianModel(parameters(60), device.as_discrete())
    model.render(view())
    with counted(monkeypatch) as traffic:
        rendering = model.render(view())
        rendering.detach()
        assert traffic.downloads == [32]
        first = rendering.depth
        assert rendering.depth is first
        assert traffic.downloads == [32, COLORS // 3]
        assert torch.equal(rendering.detach().rgb, rendering.rgb)
        assert traffic.downloads == [32, COLORS // 3, COLORS]
        assert set(rendering.fetched) == {"depth", "rgb"}


def test_a_target_is_copied_once_and_again_after_a_write(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = GaussianModel(parameters(60), device.as_discrete())
    photo, known = target(), model.device.uploads

    def loss(photo: torch.Tensor) -> float:
        return float(photometric_loss(model.render(view()), photo).detach())

    before = loss(photo)
    with counted(monkeypatch) as traffic:
        assert loss(photo) == before
        assert COLORS not in traffic.uploads
        photo[:, :, 0] = 0
        assert loss(photo) != before
        assert traffic.uploads.count(COLORS) == 1
    assert len(known) == 1
    del photo
    assert len(known) == 0


@pytest.mark.parametrize("weight", [1.0, 0.3])
@pytest.mark.parametrize("extra", [False, True], ids=["alone", "beside another term"])
def test_a_loss_on_the_device_has_the_bits_of_one_on_the_host(
    model: GaussianModel, weight: float, extra: bool
) -> None:
    results = []
    for stays in (True, False):
        model.zero_gradients()
        rendering = model.render(view())
        loss = photometric_loss(
            rendering if stays else rendering.rgb, target(), device=model.device
        )
        total = weight * loss
        if extra:
            total = total + rendering.rgb.square().mean() + rendering.depth.mean()
        for _ in range(2):  # the graph is kept, and gives the same again
            model.zero_gradients()
            total.backward(retain_graph=True)
        results.append([total.detach(), *gradients_of(model).values()])
    for ours, theirs in zip(*results, strict=True):
        assert torch.equal(ours, theirs)


def test_two_losses_of_one_render_add_up(model: GaussianModel) -> None:
    rendering = model.render(view())
    model.zero_gradients()
    losses = [photometric_loss(rendering, target(seed)) for seed in range(2)]
    torch.stack(losses).sum().backward()
    both = gradients_of(model)
    model.zero_gradients()
    rgb = model.render(view()).rgb
    losses = [photometric_loss(rgb, target(seed), device=model.device) for seed in range(2)]
    torch.stack(losses).sum().backward()
    for ours, theirs in zip(both.values(), gradients_of(model).values(), strict=True):
        assert torch.allclose(ours, theirs, rtol=1e-4, atol=1e-9)


def test_a_first_read_without_gradients_keeps_them(model: GaussianModel) -> None:
    rendering = model.render(view())
    with torch.no_grad():
        assert float(rendering.rgb.sum()) > 0
    model.zero_gradients()
    rendering.rgb.sum().backward()
    assert model.gradient("sh").any()
    with torch.no_grad():
        silent = model.render(view())
    assert not silent.rgb.requires_grad


def test_images_survive_the_renders_that_follow(model: GaussianModel) -> None:
    expected = [model.render(view(seed)).alpha.detach().clone() for seed in range(4)]
    with torch.no_grad():
        renderings = [model.render(view(seed)) for seed in range(4)]
        later = model.render(view(7)).alpha
    for rendering, truth in zip(renderings, expected, strict=True):
        assert torch.equal(rendering.alpha, truth)
        assert not torch.equal(rendering.alpha, later)


def test_a_render_uses_the_memory_of_one_whose_images_nobody_has_read(device: Device) -> None:
    model = GaussianModel(parameters(60), device)

    def rendered(*, read: bool) -> tuple[int, torch.Tensor | None]:
        rendering = model.render(view())
        outputs = rendering.device_outputs
        assert outputs is not None
        return outputs.images["rgb"].buffer.int_ptr, rendering.rgb if read else None

    first, _ = rendered(read=False)
    second, image = rendered(read=True)
    assert second == first
    assert image is not None
    third, _ = rendered(read=False)
    assert third != second  # the tensor outlives its rendering
    assert torch.equal(image, model.render(view()).rgb)


def test_a_modified_image_raises_in_backward(device: Device) -> None:
    model = GaussianModel(parameters(60), device)
    rendering = model.render(view())
    rendering.rgb.detach().mul_(2)
    if not device.shares_memory:
        pytest.skip("the device has a copy of its own")
    with pytest.raises(ExplainedError, match="'rgb' of a render was modified"):
        rendering.alpha.sum().backward()


def test_the_gpus_backward_pass_waits_once_a_pixel_for_32_pairs() -> None:
    """In the source: 287 rounds for the 256 pixels of a tile, which a group of 32 pairs shares."""
    kernels = Path(core_rasterizer.__file__).parent / "raster" / "kernels"
    source = (kernels / "raster_gpu.cl").read_text("utf-8")
    backward = source[source.index("void raster_backward(") :]
    rounds = backward.index("for (int round = 0; round < GROUP + BUCKET - 1; round++)")
    assert backward.count("barrier(") == 1
    assert backward.index("barrier(") > rounds
    assert open_device().as_variant("gpu").profile.bucket == 32


def test_a_rendering_has_no_other_images() -> None:
    rendering = Rendering.lazy(lambda name: torch.zeros(2, 2))
    assert rendering.alpha.shape == (2, 2)
    with pytest.raises(AttributeError, match="normals"):
        _ = rendering.normals  # type: ignore[attr-defined]
