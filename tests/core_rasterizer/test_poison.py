"""Extreme values in any input: NaN, infinities, the ends of the number range, exact thresholds.

Expected: a finite image and finite gradients, or an error that names the value. The suite tests 300 fixed
scenes on every device; `make stress` tests 10,000 new ones.
"""

from __future__ import annotations

import math
import os

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, event, given, settings, strategies as st

from core_rasterizer import (
    Adam,
    Camera,
    CameraError,
    Device,
    ExplainedError,
    GaussianError,
    GaussianModel,
    Gaussians,
    Rendering,
    photometric_loss,
    rasterize,
)
from core_rasterizer.layout import PARAMETERS, padded
from core_rasterizer.raster import NEAR_PLANE, pack
from tests.core_rasterizer.options import posed
from tests.core_rasterizer.quick_device import QuickDevice
from tests.core_rasterizer.scenes import NAMES, Scene, gradient, random_scene, rates, weighted_loss

IN_THE_SUITE = 300
SCENES = int(os.environ.get("STRESS_SCENES", IN_THE_SUITE))
"""On each engine; a third of them through each of the three tests."""

FOCAL, DEPTH = 32.0, 2.0
"""A mean at (x, y, 2) lies at pixel (16 x, 16 y): whole numbers are edges of tiles."""


def beside(value: float) -> list[float]:
    """A float32, and its two neighbours."""
    exact = np.float32(value)
    below, above = (np.nextafter(exact, np.float32(end)) for end in (-np.inf, np.inf))
    return [float(number) for number in (below, exact, above)]


UNDEFINED = [math.nan, math.inf, -math.inf]
RANGE = [1e38, -1e38, 1e37, 9.9e36, -1e30, 1e19, 1.9e19, 1e18, -1e10, 1e5, 3.4e38]
TINY = [0.0, -0.0, 1e-45, -1e-45, 1e-40, 1.2e-38, 1e-30, 1e-13, 1e-12, -1e-6]
THRESHOLDS = [x for value in (1 / 255, 0.99, 1e-4, NEAR_PLANE, 1.0, 88.0) for x in beside(value)]
EDGES = [x for value in (1.0, 2.0, 4.0, 1 / 32, 65 / 16) for x in (value, -value)]
EXPONENTS = [-104.0, -88.0, -5.5413, 44.0, 88.7, 89.0, 700.0]
POISONS = UNDEFINED + RANGE + TINY + THRESHOLDS + EDGES + EXPONENTS
BEYOND_FLOAT = [1e300, -1e300, 1e-300, 5e-324, 1e39]

slots = st.tuples(
    st.sampled_from(NAMES), st.integers(0, 10_000), st.sampled_from(POISONS), st.booleans()
)
camera_slots = st.tuples(
    st.sampled_from(("fx", "fy", "cx", "cy", "x", "y", "z", "pose", "near", "red", "blue")),
    st.sampled_from(POISONS + BEYOND_FLOAT),
)
smoothing_slots = st.tuples(
    st.integers(0, 10_000),
    st.sampled_from([x for x in POISONS + BEYOND_FLOAT if not x < 0]),
    st.booleans(),
)
degrees = st.sampled_from([0.5, 1.5, 2.5, 2.0, 7.5, 1e-300, 2.9999999999999996, math.nan, -1e-9])
loss_scales = st.sampled_from([1.0, 1.0, 1.0, 1e-30, 1e10, 1e30, 1e37])
sizes = st.sampled_from([(1, 1), (16, 16), (17, 5), (65, 33)])


@st.composite
def poisoned_scenes(draw: st.DrawFn) -> Scene:
    """A few Gaussians, each number of which may be replaced; or a field of all of them at once."""
    generator = torch.Generator().manual_seed(draw(st.integers(0, 3)))
    scene = random_scene(generator, draw(st.sampled_from([1, 5, 17])), draw(st.integers(0, 3)))
    scene.means[:, 2] = DEPTH
    for field, index, value, everywhere in draw(st.lists(slots, max_size=6)):
        values = getattr(scene, field)
        flat = values.reshape(len(values), -1)
        flat[slice(None) if everywhere else index % len(flat), index % flat.shape[1]] = value
    return scene


@st.composite
def poisoned_views(draw: st.DrawFn) -> tuple[dict[str, float], tuple[int, int]]:
    """Numbers of the camera, the near plane and the background; and an image size."""
    numbers = {"fx": FOCAL, "fy": FOCAL, "cx": 0.0, "cy": 0.0, "near": NEAR_PLANE}
    numbers |= dict.fromkeys(("x", "y", "z", "pose", "red", "blue"), 0.0)
    for slot, value in draw(st.lists(camera_slots, max_size=2)):
        numbers[slot] = value
    return numbers, draw(sizes)


def camera_of(numbers: dict[str, float], size: tuple[int, int]) -> Camera:
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, 3] = torch.tensor([numbers[axis] for axis in "xyz"], dtype=torch.float64)
    pose[0, 1] += numbers["pose"]
    fx, fy, cx, cy = (numbers[name] for name in ("fx", "fy", "cx", "cy"))
    return Camera(pose, fx, fy, cx, cy, *size)


def assert_finite(**tensors: torch.Tensor) -> None:
    for name, values in tensors.items():
        assert torch.isfinite(values).all(), f"{name} is not finite"


def images_of(rendering: Rendering) -> dict[str, torch.Tensor]:
    return {name: getattr(rendering, name) for name in ("rgb", "depth", "alpha")}


stress = settings(
    max_examples=SCENES // 3,
    database=None,
    derandomize=SCENES == IN_THE_SUITE,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


@stress
@given(
    scene=poisoned_scenes(),
    view=poisoned_views(),
    loss_scale=loss_scales,
    double=st.sampled_from([False] * 7 + [True]),
)
def test_the_function(
    device: Device,
    scene: Scene,
    view: tuple[dict[str, float], tuple[int, int]],
    loss_scale: float,
    double: bool,
) -> None:
    """`rasterize`: scales and opacities are given as such."""
    numbers, size = view
    leaves = scene.tensors(torch.float64 if double else torch.float32)
    refusal: ExplainedError | None = None
    try:
        camera = camera_of(numbers, size)
        rendering = rasterize(
            *leaves,
            camera,
            (numbers["red"], 0.5, numbers["blue"]),
            near=numbers["near"],
            device=device,
        )
    except (CameraError, GaussianError) as error:
        refusal = error
    if refusal is not None:
        assert refusal.where
        event(f"refused: {refusal.where}")
        return
    (loss_scale * weighted_loss(rendering, 0)).backward()
    event("something seen" if rendering.alpha.any() else "nothing seen")
    gradients = {f"gradient of {name}": gradient(t) for name, t in zip(NAMES, leaves, strict=True)}
    assert_finite(**images_of(rendering), **gradients)


@stress
@given(
    scene=poisoned_scenes(),
    view=poisoned_views(),
    smoothed=st.lists(smoothing_slots, max_size=2),
    degree=degrees,
    dilation=st.sampled_from([0.3, 0.0]),
    loss_scale=loss_scales,
)
def test_poses_and_filters(
    device: QuickDevice,
    scene: Scene,
    view: tuple[dict[str, float], tuple[int, int]],
    smoothed: list[tuple[int, float, bool]],
    degree: float,
    dilation: float,
    loss_scale: float,
) -> None:
    """`rasterize` with all options; without dilation, ellipses may have no area."""
    numbers, size = view
    leaves = scene.tensors(torch.float32)
    smoothing = torch.full((len(scene.means),), 0.05, dtype=torch.float64)
    for index, value, everywhere in smoothed:
        smoothing[slice(None) if everywhere else index % len(smoothing)] = value
    refusal: ExplainedError | None = None
    try:
        camera, pose = posed(camera_of(numbers, size))
        rendering = rasterize(
            *leaves,
            camera,
            near=numbers["near"],
            sh_degree=degree,
            dilation=dilation,
            compensate_dilation=True,
            smoothing=smoothing,
            device=device.unoptimized,
        )
    except (CameraError, GaussianError) as error:
        refusal = error
    if refusal is not None:
        assert refusal.where
        event(f"refused: {refusal.where}")
        return
    (loss_scale * weighted_loss(rendering, 0)).backward()
    event("something seen" if rendering.alpha.any() else "nothing seen")
    gradients = {f"gradient of {name}": gradient(t) for name, t in zip(NAMES, leaves, strict=True)}
    assert_finite(**images_of(rendering), **gradients, pose=gradient(pose).float())


@stress
@given(
    scene=poisoned_scenes(),
    size=sizes,
    factor=st.sampled_from([1.0, 1.0, *POISONS]),
    loss_scale=loss_scales,
)
def test_the_model_and_a_step_of_training(
    device: Device, scene: Scene, size: tuple[int, int], factor: float, loss_scale: float
) -> None:
    """The resident model, whose scales and opacities are logarithms and logits, with loss and Adam.

    The constructor rejects values that are not finite; this test passes them to the kernels anyway.
    """
    given = Gaussians(
        **{
            name: values.float()
            for name, values in zip(
                PARAMETERS,
                (scene.means, scene.scales, scene.quaternions, scene.opacities, scene.sh),
                strict=True,
            )
        }
    )
    rows = pack(given, torch.float32, padded(len(given)))
    finite = torch.isfinite(rows)
    if not finite.all():
        with pytest.raises(GaussianError) as error:
            given.check_finite()
        field, index = error.value.field, error.value.index
        assert not torch.isfinite(getattr(given, field)[index]).all()
    for name in PARAMETERS:
        getattr(given, name).nan_to_num_(0.0, 0.0, 0.0)
    model = GaussianModel(given, device)
    model.adopt(rows.clone(), len(given))
    optimizer = Adam(model)
    rendering = model.render(
        camera_of(
            {"fx": FOCAL, "fy": FOCAL, "cx": 0, "cy": 0, "x": 0, "y": 0, "z": 0, "pose": 0}, size
        ),
        opacity_scale=None if factor == 1.0 else torch.full((model.count,), factor),
        collect_statistics=True,
    )
    assert_finite(**images_of(rendering))
    loss = loss_scale * weighted_loss(rendering, 0)
    refusal = ""
    try:
        loss = loss + photometric_loss(rendering.rgb, torch.rand(*size[::-1], 3), device=device)
    except ExplainedError as error:
        refusal = error.what
    assert not refusal or "overflow" in refusal
    loss.backward()
    assert_finite(
        screen_gradient=model.statistics.screen_gradient(),
        **{f"gradient of {name}": model.gradient(name) for name in PARAMETERS},
    )
    optimizer.step(rates(1e-2), active_sh_degree=3)
    assert torch.equal(torch.isfinite(model.parameters.read()), finite)
    assert_finite(**optimizer.state())
