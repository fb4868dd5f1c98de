"""The kernels against the oracle, against an independent implementation, and against finite differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from core_rasterizer import Camera, Device, GaussianError, rasterize, reference
from tests.core_rasterizer.scenes import (
    NAMES,
    Scene,
    gradient,
    random_camera,
    random_scene,
    relative_error,
    weighted_loss,
)
from tests.data import data_folder


@pytest.mark.parametrize("seed", range(6))
def test_agrees_with_the_oracle(device: Device, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    scene, camera = (
        random_scene(generator, 300, sh_degree=seed % 4),
        random_camera(generator, 90, 70),
    )
    background = (0.2, 0.5, 0.9)
    truth_leaves, leaves = scene.tensors(), scene.tensors(torch.float32)
    truth = reference.render(*truth_leaves, camera, background)
    weighted_loss(truth, seed).backward()
    rendering = rasterize(*leaves, camera, background, device=device)
    weighted_loss(rendering, seed).backward()
    for name in ("rgb", "depth", "alpha"):
        assert relative_error(getattr(rendering, name), getattr(truth, name)) < 1e-6, name
    for name, leaf, truth_leaf in zip(NAMES, leaves, truth_leaves, strict=True):
        if gradient(truth_leaf).abs().max() > 0:
            assert relative_error(gradient(leaf), gradient(truth_leaf)) < 2e-5, name


@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_the_oracle_to_rounding_in_double(device: Device, seed: int) -> None:
    generator = torch.Generator().manual_seed(100 + seed)
    scene, camera = random_scene(generator, 120, spread=2.5), random_camera(generator)
    truth_leaves, leaves = scene.tensors(), scene.tensors()
    weighted_loss(reference.render(*truth_leaves, camera), seed).backward()
    weighted_loss(rasterize(*leaves, camera, device=device), seed).backward()
    for name, leaf, truth_leaf in zip(NAMES, leaves, truth_leaves, strict=True):
        assert relative_error(gradient(leaf), gradient(truth_leaf)) < 1e-9, name


@pytest.mark.parametrize("name", ["surf_3000", "garden_3000"])
def test_agrees_with_an_independent_implementation(device: Device, name: str) -> None:
    golden = np.load(data_folder("golden_render") / f"{name}.npz")
    camera = Camera(
        golden["world_to_camera"],
        **{key: float(golden[key]) for key in ("fx", "fy", "cx", "cy")},
        width=int(golden["width"]),
        height=int(golden["height"]),
    )
    arrays: dict[str, Any] = {key: torch.tensor(golden[key], requires_grad=True) for key in NAMES}
    leaves = list(arrays.values())
    rendering = rasterize(**arrays, camera=camera, near=0.01, device=device)
    loss = torch.zeros(())
    for key in ("rgb", "depth", "alpha"):
        truth = torch.tensor(golden[key])
        image = getattr(rendering, key)
        off = (image.double() - truth).abs() > 1e-5 * truth.abs().max()
        assert off.double().mean() <= 1e-4, key  # only at thresholds
        loss = loss + (image * torch.tensor(golden[f"weight_{key}"], dtype=torch.float32)).sum()
    loss.backward()
    for key, leaf in zip(NAMES, leaves, strict=True):
        assert relative_error(gradient(leaf), torch.tensor(golden[f"grad_{key}"])) < 1e-4, key


def test_the_same_scene_gives_the_same_bits(device: Device) -> None:
    generator = torch.Generator().manual_seed(3)
    scene, camera = random_scene(generator, 500), random_camera(generator, 200, 150)
    runs = []
    for _ in range(3):
        leaves = scene.tensors(torch.float32)
        rendering = rasterize(*leaves, camera, device=device)
        weighted_loss(rendering, 0).backward()
        runs.append([rendering.rgb.detach(), rendering.depth.detach(), *map(gradient, leaves)])
    for other in runs[1:]:
        assert all(torch.equal(a, b) for a, b in zip(runs[0], other, strict=True))


def test_both_raster_variants_agree(device: Device) -> None:
    if device.kind == "cpu" and device.variant == "gpu":
        pytest.skip("compared with the other variant of this device")
    generator = torch.Generator().manual_seed(4)
    scene, camera = random_scene(generator, 800), random_camera(generator, 180, 130)
    leaves = scene.tensors()
    truth = reference.render(*leaves, camera)
    weighted_loss(truth, 0).backward()
    expected = [truth.rgb.detach(), *map(gradient, leaves)]
    images = []
    for variant in ("cpu", "gpu"):
        leaves = scene.tensors(torch.float32)
        rendering = rasterize(*leaves, camera, device=device.as_variant(variant))
        weighted_loss(rendering, 0).backward()
        images.append(rendering.rgb.detach())
        for one, exact in zip([images[-1], *map(gradient, leaves)], expected, strict=True):
            assert relative_error(one, exact) < 1e-5
    assert relative_error(*images) < 1e-5


def test_equal_depths_are_ordered_by_index(device: Device) -> None:
    camera = Camera(torch.eye(4), 20.0, 20.0, 8.0, 8.0, 16, 16)
    sh = torch.zeros(2, 1, 3)
    sh[0, 0, 0], sh[1, 0, 1] = 1.7, 1.7  # red, then green
    common = (torch.tensor([[1.0, 0, 0, 0]] * 2), torch.full((2, 3), 0.5), torch.full((2,), 0.9))
    means = torch.tensor([[0.0, 0.0, 2.0]] * 2)
    first = rasterize(means, *common, sh, camera, device=device).rgb[8, 8]
    second = rasterize(means, *common, sh.flip(0), camera, device=device).rgb[8, 8]
    assert first[0] > first[1]
    assert second[1] > second[0]


@pytest.mark.parametrize("size", [(1, 1), (17, 3), (65, 33), (129, 97)])
def test_any_image_size(device: Device, size: tuple[int, int]) -> None:
    generator = torch.Generator().manual_seed(5)
    scene, camera = random_scene(generator, 60), random_camera(generator, *size)
    truth = reference.render(*scene.tensors(), camera)
    rendering = rasterize(*scene.tensors(torch.float32), camera, device=device)
    assert rendering.rgb.shape == (size[1], size[0], 3)
    assert torch.allclose(rendering.rgb.double(), truth.rgb, atol=1e-5)


@pytest.mark.parametrize("where", ["none", "behind", "outside", "faint"])
def test_nothing_to_see_is_background_and_zero_gradient(device: Device, where: str) -> None:
    generator = torch.Generator().manual_seed(6)
    scene, camera = random_scene(generator, 0 if where == "none" else 20), random_camera(generator)
    if where == "behind":
        scene.means[:, 2] = -3.0
    if where == "outside":
        scene.means[:, 0] += 1e4
    if where == "faint":
        scene.opacities[:] = 1 / 256
    leaves = scene.tensors(torch.float32)
    rendering = rasterize(*leaves, camera, (0.1, 0.2, 0.3), device=device)
    weighted_loss(rendering, 0).backward()
    assert torch.allclose(rendering.rgb, torch.tensor([0.1, 0.2, 0.3]).expand_as(rendering.rgb))
    assert not rendering.alpha.any()
    assert not rendering.depth.any()
    assert all(not gradient(leaf).any() for leaf in leaves)


@pytest.mark.parametrize("field", NAMES)
@pytest.mark.parametrize("poison", [float("nan"), float("inf"), -float("inf"), 1e38])
def test_an_undefined_gaussian_harms_no_other(device: Device, field: str, poison: float) -> None:
    """One undefined Gaussian: images and gradients stay finite, and those of others unchanged."""
    generator = torch.Generator().manual_seed(7)
    scene, camera = random_scene(generator, 50), random_camera(generator)
    getattr(scene, field).reshape(50, -1)[11, -1] = poison
    leaves = scene.tensors(torch.float32)
    rendering = rasterize(*leaves, camera, device=device)
    weighted_loss(rendering, 0).backward()
    assert all(torch.isfinite(t).all() for t in (rendering.rgb, rendering.depth, rendering.alpha))
    assert all(torch.isfinite(gradient(leaf)).all() for leaf in leaves)
    if not np.isfinite(poison):
        rest = Scene(*(t.detach().double()[torch.arange(50) != 11] for t in leaves))
        alone = rasterize(*rest.tensors(torch.float32), camera, device=device)
        assert torch.allclose(alone.rgb, rendering.rgb, atol=1e-6)


def test_a_zero_quaternion_is_the_identity(device: Device) -> None:
    generator = torch.Generator().manual_seed(8)
    scene, camera = random_scene(generator, 5), random_camera(generator)
    scene.quaternions[:] = 0
    leaves = scene.tensors(torch.float32)
    rendering = rasterize(*leaves, camera, device=device)
    weighted_loss(rendering, 0).backward()
    assert not gradient(leaves[1]).any()
    scene.quaternions[:, 0] = 1
    upright = rasterize(*scene.tensors(torch.float32), camera, device=device)
    assert torch.equal(upright.rgb, rendering.rgb)


def test_wrong_shapes_and_types_are_named(device: Device) -> None:
    generator = torch.Generator().manual_seed(9)
    scene, camera = random_scene(generator, 5), random_camera(generator)
    means, quaternions, scales, opacities, sh = scene.tensors(torch.float32)
    with pytest.raises(GaussianError, match="expected") as error:
        rasterize(means, quaternions, scales, opacities[:4], sh, camera, device=device)
    assert error.value.field == "opacities"
    with pytest.raises(GaussianError, match="float64") as error:
        rasterize(means, quaternions, scales.double(), opacities, sh, camera, device=device)
    assert error.value.field == "scales"
