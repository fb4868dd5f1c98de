"""The settings that `make bench-error` compares, and their defaults."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
import torch
from torch import Tensor

from core_rasterizer import (
    Adam,
    Camera,
    Device,
    ExplainedError,
    GaussianModel,
    Gaussians,
    reference,
)
from core_rasterizer.layout import PARAMETERS
from core_rasterizer.raster import Renderer, RenderRequest
from tests.core_rasterizer.quick_device import QuickDevice
from tests.core_rasterizer.scenes import (
    activated,
    gradients_of,
    parameters,
    rates,
    relative_error,
    view,
)

Overrides = Mapping[str, float]
RATES = rates(1e-2)


@pytest.fixture(scope="module")
def device(device: QuickDevice) -> Device:
    """Many variants of the kernels are built here."""
    return device.unoptimized


def outcome(
    device: Device,
    overrides: Overrides,
    dtype: torch.dtype = torch.float32,
    gaussians: Gaussians | None = None,
    camera: Camera | None = None,
) -> dict[str, Tensor]:
    """The images, and the gradients of a loss on all three."""
    model = GaussianModel(gaussians or parameters(), device, dtype=dtype)
    model.renderer = Renderer(device, dtype, overrides=overrides)
    model.zero_gradients()
    rendering = model.render(camera or view())
    images = {"rgb": rendering.rgb, "depth": rendering.depth, "alpha": rendering.alpha}
    sum((image.square().sum() for image in images.values()), torch.zeros(())).backward()
    return {name: image.detach() for name, image in images.items()} | gradients_of(model)


def pairs(device: Device, overrides: Overrides) -> int:
    """Number of (tile, Gaussian) pairs of a render."""
    model = GaussianModel(parameters(), device)
    renderer = Renderer(device, overrides=overrides)
    lease = renderer.forward(model.block, RenderRequest(view(), (0.0, 0.0, 0.0), 3))[1]
    return lease.frame.pairs


def oracle(gaussians: Gaussians) -> Tensor:
    """The colour image of `reference.py` with its current constants."""
    return reference.render(*activated(gaussians), view()).rgb


def test_a_setting_that_no_kernel_knows_is_refused(device: Device) -> None:
    with pytest.raises(ExplainedError, match="ALPHA_CUT_INVERS"):
        Renderer(device, overrides={"ALPHA_CUT_INVERS": 255})


def test_the_defaults_written_out_give_the_same_bits(device: Device) -> None:
    defaults = {
        "ALPHA_CUT_INVERSE": 255,
        "EARLY_STOP": 1e-4,
        "EXP2_DEGREE": 5,
        "EXACT_TILE_TEST": 1,
    }
    ours, theirs = outcome(device, {}), outcome(device, defaults)
    for name in ours:
        assert torch.equal(ours[name], theirs[name]), name


def test_the_exact_tile_test_drops_pairs_and_changes_nothing(device: Device) -> None:
    small = {"TILE_WIDTH": 32, "TILE_HEIGHT": 16} if device.variant == "cpu" else {}
    assert pairs(device, small) < pairs(device, small | {"EXACT_TILE_TEST": 0})
    ours, theirs = outcome(device, small), outcome(device, small | {"EXACT_TILE_TEST": 0})
    for name in ours:
        assert torch.equal(ours[name], theirs[name]), name


@pytest.mark.parametrize("length", [0.2, 1.0, 4.0, 30.0])
def test_rows_outside_slanted_ellipses_change_nothing(device: Device, length: float) -> None:
    if device.variant == "gpu":
        pytest.skip("its work-items blend one pixel each")
    gaussians = parameters(800)
    generator = torch.Generator().manual_seed(0)
    thin = length * 10 ** (-4 * torch.rand(800, 2, generator=generator))
    gaussians.log_scales[:] = torch.cat([torch.full((800, 1), length), thin], 1).log()
    camera = Camera(torch.eye(4), 150.0, 150.0, 100.0, 75.0, 201, 151)
    never, always = ({"SLANTED": value} for value in (5, -1))
    theirs = outcome(device, never, gaussians=gaussians, camera=camera)
    for overrides in ({}, always):
        ours = outcome(device, overrides, gaussians=gaussians, camera=camera)
        for name in ours:
            assert torch.equal(ours[name], theirs[name]), name


@pytest.mark.parametrize(("inverse", "stop"), [(1e6, 1e-12), (127.5, 1e-2)])
def test_the_alpha_cut_off_and_the_early_stop_are_where_they_are_set(
    device: Device, inverse: float, stop: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Images agree with the oracle only if both of its constants are changed."""
    gaussians = parameters(600)
    overrides = {"ALPHA_CUT_INVERSE": inverse, "EARLY_STOP": stop}
    images = outcome(device, overrides, torch.float64, gaussians)
    with monkeypatch.context() as patch:
        patch.setattr(reference, "TRANSMITTANCE_MIN", stop)
        assert relative_error(images["rgb"], oracle(gaussians)) > 1e-4
    monkeypatch.setattr(reference, "ALPHA_MIN", 1 / inverse)
    assert relative_error(images["rgb"], oracle(gaussians)) > 1e-6
    monkeypatch.setattr(reference, "TRANSMITTANCE_MIN", stop)
    assert relative_error(images["rgb"], oracle(gaussians)) < 1e-10


def test_each_degree_of_the_exponential_has_its_error(device: Device) -> None:
    """One Gaussian with a loss on its centre, far from thresholds."""
    gaussians = Gaussians(
        means=torch.tensor([[0.0, 0.0, 2.0]]),
        log_scales=torch.full((1, 3), -1.5),
        quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        opacity_logits=torch.tensor([1.0]),
        sh=torch.zeros(1, 1, 3),
    )
    camera = Camera(torch.eye(4), 60.0, 60.0, 20.0, 15.0, 40, 30)

    def alpha(overrides: Overrides, dtype: torch.dtype = torch.float32) -> Tensor:
        model = GaussianModel(gaussians, device, dtype=dtype)
        model.renderer = Renderer(device, dtype, overrides=overrides)
        return model.render(camera).alpha.detach().double()

    truth = alpha({}, torch.float64)
    middle = truth > 0.05
    assert middle.sum() > 100
    errors = {
        degree: float(((alpha({"EXP2_DEGREE": degree}) - truth) / truth)[middle].abs().max())
        for degree in (0, 5, 4, 3)
    }
    # What is left without any error of the exponential is that of positions and of the sum.
    assert errors[0] < 2e-6
    assert errors[5] < 2e-6
    if device.variant == "cpu":
        assert errors[5] < errors[4] < 6e-6
        assert 2e-5 < errors[3] < 1.2e-4
    else:  # one lane takes the compiler's own function whatever the degree
        assert errors[3] == errors[4] == errors[5] == errors[0]


@pytest.mark.parametrize(
    ("dtype", "bound"),
    [
        pytest.param(torch.float32, 1e-6, id="float"),
        pytest.param(torch.float64, 1e-12, id="double", marks=pytest.mark.proof),
    ],
)
def test_tiles_and_vectors_of_any_size_give_the_same_images_and_gradients(
    device: Device, dtype: torch.dtype, bound: float
) -> None:
    sizes = [(32, 16), (64, 64)] if device.variant == "cpu" else [(8, 8), (16, 8)]
    others: list[Overrides] = [{"TILE_WIDTH": w, "TILE_HEIGHT": h} for w, h in sizes]
    if device.variant == "cpu":
        others += [{"RASTER_LANES": lanes} for lanes in (8, 16)]
        others.append({"RASTER_LANES": 16, "TILE_WIDTH": 24, "TILE_HEIGHT": 15})
    ours = outcome(device, {}, dtype)
    for overrides in others:
        theirs = outcome(device, overrides, dtype)
        for name in ours:
            errors = (theirs[name] - ours[name]).abs().flatten() / ours[name].abs().max()
            # In float a value within rounding of a threshold may fall on its other side.
            most = bound if name in ("rgb", "depth", "alpha") else 20 * bound
            assert errors.sort().values[int(0.999 * len(errors))] < most, (overrides, name)
            assert errors.max() < 1e4 * bound, (overrides, name)


def test_adam_for_the_visible_leaves_the_others_where_they_are(device: Device) -> None:
    """Two steps of which the second sees only half: dense Adam carries the others on."""
    model, other = (GaussianModel(parameters(), device) for _ in range(2))
    dense, sparse = Adam(model), Adam(other)
    sparse.program = device.program(
        "optimization/adam_values", "optimization/adam", dtype=torch.float32, VISIBLE_ONLY=1
    )
    gradients = torch.ones(model.rows, model.capacity)
    for each in (model, other):
        each.gradients.rows.write(gradients)
    dense.step(RATES, 3)
    sparse.step(RATES, 3)
    assert model.digest() == other.digest()
    before = other.read("means").clone()

    gradients[:, : model.count // 2] = 0
    for each in (model, other):
        each.gradients.rows.write(gradients)
    dense.step(RATES, 3)
    sparse.step(RATES, 3)
    unseen = slice(0, model.count // 2)
    seen = slice(model.count // 2, None)
    assert torch.equal(other.read("means")[unseen], before[unseen])
    assert (model.read("means")[unseen] != before[unseen]).all()
    for name in PARAMETERS:
        assert torch.equal(other.read(name)[seen], model.read(name)[seen]), name
