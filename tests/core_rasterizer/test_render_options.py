"""Poses, dilation and its compensation, smoothing and fractions of a band: the kernels against the oracle."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from core_rasterizer import (
    Adam,
    Device,
    ExplainedError,
    GaussianError,
    GaussianModel,
    Rendering,
    rasterize,
    reference,
)
from core_rasterizer.layout import PARAMETERS
from core_rasterizer.raster import Renderer, RenderRequest
from tests.core_rasterizer.options import all_options, posed, smoothing_of
from tests.core_rasterizer.quick_device import QuickDevice
from tests.core_rasterizer.scenes import (
    NAMES,
    activated,
    gradient,
    leaves_of,
    parameters,
    random_camera,
    random_scene,
    rates,
    relative_error,
    view,
    weighted_loss,
)
from tests.core_rasterizer.test_memory_budget import block_of

Options = Callable[[torch.Generator, int], dict[str, Any]]
OPTIONS: dict[str, Options] = {
    "pose": lambda generator, count: {},
    "dilation": lambda generator, count: {"dilation": 1.3},
    "compensation": lambda generator, count: {"compensate_dilation": True},
    "smoothing": lambda generator, count: {"smoothing": smoothing_of(generator, count)},
    "fraction": lambda generator, count: {"sh_degree": 0.3},
    "all": all_options,
}
IMAGES = ("rgb", "depth", "alpha")


@pytest.fixture(scope="module")
def device(device: QuickDevice) -> Device:
    """Many variants of the kernels are built here."""
    return device.unoptimized


@pytest.mark.parametrize(
    ("name", "dtype", "image_bound", "gradient_bound"),
    [
        *((name, torch.float64, 1e-12, 1e-9) for name in OPTIONS),
        *((name, torch.float32, 1e-6, 2e-5) for name in ("pose", "all")),
    ],
)
def test_agrees_with_the_oracle(
    device: Device, name: str, dtype: torch.dtype, image_bound: float, gradient_bound: float
) -> None:
    """At the bounds of a plain render; the pose's gradient at those of the others."""
    generator = torch.Generator().manual_seed(1)
    scene, camera = random_scene(generator, 300), random_camera(generator, 90, 70)
    options = OPTIONS[name](generator, 300)
    results = []
    functions: list[tuple[Callable[..., Rendering], dict[str, Any]]]
    functions = [(reference.render, {}), (rasterize, {"device": device})]
    for function, on in functions:
        leaves = scene.tensors(dtype)
        with_pose, pose = posed(camera)
        rendering = function(*leaves, with_pose, (0.2, 0.5, 0.9), **options, **on)
        weighted_loss(rendering, 0).backward()
        gradients = {leaf: gradient(value) for leaf, value in zip(NAMES, leaves, strict=True)}
        results.append((rendering, gradients | {"pose": gradient(pose)}))
    (truth, expected), (ours, gradients) = results
    for image in IMAGES:
        assert relative_error(getattr(ours, image), getattr(truth, image)) < image_bound, image
    for leaf in gradients:
        assert relative_error(gradients[leaf], expected[leaf]) < gradient_bound, leaf
    assert not gradients["pose"][3].any()


def test_every_option_changes_the_image(device: Device) -> None:
    generator = torch.Generator().manual_seed(2)
    scene, camera = random_scene(generator, 100), random_camera(generator)
    leaves = scene.tensors(torch.float32)
    plain = rasterize(*leaves, camera, device=device).rgb
    for name, options in OPTIONS.items():
        image = rasterize(*leaves, camera, **options(generator, 100), device=device).rgb
        assert ((image - plain).abs().max() > 1e-3) == (name != "pose"), name


def test_several_cameras_in_one_backward_have_their_own_gradients(device: Device) -> None:
    """Through the resident model; the right eye of a stereo pair hands its gradient to the left."""
    model = GaussianModel(parameters(), device, dtype=torch.float64)
    cameras, poses = zip(*(posed(view(seed)) for seed in (1, 2)), strict=True)
    views = [cameras[0], cameras[0].shifted_right(0.1), cameras[1]]
    torch.stack([model.render(camera).rgb.square().sum() for camera in views]).sum().backward()
    together = [pose.grad.clone() for pose in poses]
    alone = []
    for pose, own in zip(poses, (views[:2], views[2:]), strict=True):
        pose.grad = None
        for camera in own:
            model.render(camera).rgb.square().sum().backward()
        alone.append(pose.grad)
    assert not torch.allclose(alone[0], alone[1])
    for one, other in zip(together, alone, strict=True):
        torch.testing.assert_close(one, other)


def test_the_model_is_the_function_behind_its_activations(device: Device) -> None:
    gaussians, generator = parameters(), torch.Generator().manual_seed(3)
    options = all_options(generator, len(gaussians))
    leaves = leaves_of(gaussians, torch.float64)
    plain_camera, plain_pose = posed(view())
    plain = rasterize(*activated(leaves), plain_camera, **options, device=device)
    footprint = {name: options.pop(name) for name in ("dilation", "compensate_dilation")}
    model = GaussianModel(gaussians, device, dtype=torch.float64, **footprint)
    camera, pose = posed(view())
    resident = model.render(camera, **options)
    for rendering in (plain, resident):
        weighted_loss(rendering, 0).backward()
    assert relative_error(resident.rgb, plain.rgb) < 1e-12
    for name, leaf in vars(leaves).items():
        assert relative_error(model.gradient(name), gradient(leaf)) < 1e-10, name
    assert relative_error(gradient(pose), gradient(plain_pose)) < 1e-10


def test_a_detached_parameter_leaves_the_pose_its_gradient(device: Device) -> None:
    model = GaussianModel(parameters(), device)
    gradients = []
    for detach in ((), PARAMETERS):
        model.zero_gradients()
        camera, pose = posed(view())
        weighted_loss(model.render(camera, detach=detach), 0).backward()
        gradients.append(gradient(pose))
    assert not model.gradient("means").any()
    assert torch.equal(gradients[0], gradients[1])


def test_the_same_pose_gives_the_same_bits(device: Device) -> None:
    generator = torch.Generator().manual_seed(4)
    scene, camera = random_scene(generator, 500), random_camera(generator, 200, 150)
    options = all_options(generator, 500)
    runs = []
    for _ in range(3):
        with_pose, pose = posed(camera)
        rendering = rasterize(*scene.tensors(torch.float32), with_pose, **options, device=device)
        weighted_loss(rendering, 0).backward()
        runs.append(gradient(pose))
    assert runs[0].any()
    assert all(torch.equal(runs[0], other) for other in runs[1:])


def test_both_raster_variants_agree(device: Device) -> None:
    if device.variant == "gpu":
        pytest.skip("the CPU's variant is compared with this one; a GPU runs this one only")
    generator = torch.Generator().manual_seed(5)
    scene, camera = random_scene(generator, 800), random_camera(generator, 180, 130)
    options = all_options(generator, 800)
    results: list[list[Tensor]] = []
    for variant in ("cpu", "gpu"):
        with_pose, pose = posed(camera)
        leaves, on = scene.tensors(), device.as_variant(variant)
        rendering = rasterize(*leaves, with_pose, **options, device=on)
        weighted_loss(rendering, 0).backward()
        results.append([rendering.rgb.detach(), gradient(pose), *map(gradient, leaves)])
    for one, other in zip(*results, strict=True):
        assert relative_error(one, other) < 1e-9


def test_unused_options_are_not_built(device: Device) -> None:
    """Default renders, whole degrees and poses without gradient use the default kernels."""
    fresh = device.as_variant(device.variant)
    model = GaussianModel(parameters(), fresh)
    built = set(fresh._programs)
    model.render(view()).rgb.sum().backward()
    model.render(view(), sh_degree=2.0, opacity_scale=torch.ones(model.count)).rgb.sum().backward()
    camera, pose = posed(view())
    with torch.no_grad():
        model.render(posed(view())[0].shifted_right(0.1), sh_degree=7)
    assert set(fresh._programs) == built
    model.render(camera).rgb.sum().backward()
    assert pose.grad is not None
    assert len(fresh._programs) == len(built) + 1


def test_a_whole_degree_is_the_integer(device: Device) -> None:
    model = GaussianModel(parameters(), device)
    gradients = []
    for degree in (2, 2.0):
        model.zero_gradients()
        model.render(view(), sh_degree=degree).rgb.sum().backward()
        gradients.append(model.gradient("sh").clone())
    assert torch.equal(gradients[0], gradients[1])


def test_a_fading_band_takes_part_in_the_step(device: Device) -> None:
    """It gets a gradient and a step; bands above it do not change."""
    model = GaussianModel(parameters(), device)
    before = model.read("sh").clone()
    model.zero_gradients()
    model.render(view(), sh_degree=1.5).rgb.square().sum().backward()
    assert model.gradient("sh")[:, 4:9].any()
    assert not model.gradient("sh")[:, 9:].any()
    Adam(model).step(rates(1e-2), active_sh_degree=1.5)
    moved = (model.read("sh") != before).any(dim=0).any(dim=1)
    assert moved.tolist() == [True] * 9 + [False] * 7


@pytest.mark.parametrize(
    ("options", "place"),
    [
        ({"dilation": -0.1}, "dilation"),
        ({"dilation": math.nan}, "dilation"),
        ({"dilation": math.inf}, "dilation"),
        ({"sh_degree": -0.5}, "sh_degree"),
        ({"sh_degree": math.nan}, "sh_degree"),
        ({"smoothing": torch.zeros(4)}, "smoothing"),
        ({"smoothing": torch.tensor([0, 0, 0, -1e-9, 0])}, "smoothing[3]"),
        ({"smoothing": torch.tensor([0, math.nan, 0, 0, 0])}, "smoothing[1]"),
        ({"smoothing": torch.tensor([0, 0, math.inf, 0, 0])}, "smoothing[2]"),
    ],
)
def test_invalid_options_raise(device: Device, options: dict[str, Any], place: str) -> None:
    generator = torch.Generator().manual_seed(6)
    scene, camera = random_scene(generator, 5), random_camera(generator)
    with pytest.raises(GaussianError) as error:
        rasterize(*scene.tensors(torch.float32), camera, **options, device=device)
    assert error.value.where == place
    gaussians = parameters(5)
    at_construction = {name: options[name] for name in options if name == "dilation"}
    at_render = {name: options[name] for name in options if name != "dilation"}
    with pytest.raises(GaussianError) as error:
        GaussianModel(gaussians, device, **at_construction).render(camera, **at_render)
    assert error.value.where == place


def test_a_degree_above_the_stored_one_uses_all_bands(device: Device) -> None:
    generator = torch.Generator().manual_seed(7)
    scene, camera = random_scene(generator, 20, sh_degree=1), random_camera(generator)
    leaves = scene.tensors(torch.float32)
    whole = rasterize(*leaves, camera, device=device).rgb
    assert torch.equal(rasterize(*leaves, camera, sh_degree=1.5, device=device).rgb, whole)


def test_an_undefined_image_gradient_raises_before_the_pose_gradient(device: Device) -> None:
    generator = torch.Generator().manual_seed(8)
    scene, (camera, pose) = random_scene(generator, 5), posed(random_camera(generator))
    rendering = rasterize(*scene.tensors(torch.float32), camera, device=device)
    with pytest.raises(ExplainedError, match="undefined gradient"):
        (rendering.rgb.sum() * math.nan).backward()
    assert pose.grad is None


def test_the_gradient_of_a_pose_counts_against_the_memory_budget(device: Device) -> None:
    block, renderer = block_of(device, 4000), Renderer(device, memory_budget=2**28)
    limits = []
    for camera in (view(), posed(view())[0]):
        request = RenderRequest(camera, (0.0, 0.0, 0.0), 0)
        limits.append(renderer.forward(block, request)[1].frame.pair_limit)
    kept = 16 * 8 * block.capacity // device.lanes
    assert limits[0] - limits[1] == pytest.approx(kept / renderer.budget.bytes_of_pair, abs=1)
