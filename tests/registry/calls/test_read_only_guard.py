from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from core_rasterizer import Device, GaussianModel
from registry import PluginError, Scene
from registry.calls.read_only_guard import (
    ReadOnlyGuard,
    of_maps,
    of_rendering,
    of_scene,
)
from registry.priors import DepthMap
from registry.testing import tiny_scene
from tests.host import TrainingSettings, initial_gaussians

Write = Callable[[Scene], object]


def positions(scene: Scene) -> torch.Tensor:
    assert scene.points is not None
    return scene.points.positions


THROUGH_TORCH: list[tuple[str, Write]] = [
    ("the photograph of view0", lambda s: s.train[0].image.mul_(0.5)),
    ("the photograph of view0", lambda s: s.train[0].image[:4].zero_()),
    ("the photograph of view1", lambda s: s.test[0].image.detach().fill_(1)),
    ("the photograph of view2", lambda s: s.train[1].image.requires_grad_()),
    ("the camera of view2", lambda s: s.train[1].camera.world_to_camera[0, 3].add_(1)),
    ("the depth of view0", lambda s: torch.add(torch.ones(24, 32), 1, out=s.train[0].depth)),
    ("the positions of the scene's points", lambda s: positions(s).clamp_(max=0)),
]
BYPASSING_TORCH: list[tuple[str, Write]] = [
    ("the photograph of view0", lambda s: s.train[0].image.numpy().fill(0.5)),
    ("the photograph of view0", lambda s: s.train[0].image.data.mul_(0.5)),
    ("the camera of view0", lambda s: s.train[0].camera.world_to_camera.numpy().fill(float("nan"))),
]


@pytest.mark.parametrize(("name", "write"), THROUGH_TORCH)
def test_writes_through_torch_are_refused(name: str, write: Write) -> None:
    scene = tiny_scene()
    with pytest.raises(PluginError, match=f"wrote into {name}") as caught, of_scene(scene).kept():
        write(scene)
    assert "clone" in caught.value.fix


@pytest.mark.parametrize(("name", "write"), BYPASSING_TORCH)
def test_writes_that_bypass_torch_are_refused_if_every_bit_is_compared(
    name: str, write: Write
) -> None:
    scene = tiny_scene()
    guard = of_scene(scene)
    with pytest.raises(PluginError, match=f"wrote into {name}"), guard.kept(every_bit=True):
        write(scene)


def test_reading_is_accepted() -> None:
    scene = tiny_scene()
    scene.train[0].image[0, 0, 0] = float("nan")
    with of_scene(scene).kept(every_bit=True):
        (scene.train[0].image * 2).mean()
        torch.from_numpy(scene.train[0].image.numpy()).sum()


def test_the_guard_of_a_training_scene_omits_test_views() -> None:
    scene = tiny_scene()
    with of_scene(scene.for_training()).kept():
        scene.test[0].image.zero_()


def test_maps_are_guarded() -> None:
    known = DepthMap(torch.ones(2, 2), torch.ones(2, 2, dtype=torch.bool), torch.ones(2, 2))
    with (
        pytest.raises(PluginError, match="the initializer's depth of view0"),
        of_maps({"view0": known}).kept(),
    ):
        known.depth.add_(1)


def test_inference_tensors_can_be_guarded() -> None:
    with torch.inference_mode():
        tensor = torch.ones(3)
    guard = ReadOnlyGuard({"it": tensor})
    with guard.kept():
        pass
    with pytest.raises(PluginError), guard.kept(every_bit=True), torch.inference_mode():
        tensor.zero_()


def test_gaussians_are_compared(device: Device) -> None:
    points = tiny_scene().points
    assert points is not None
    model = GaussianModel(initial_gaussians(points, TrainingSettings(sh_degree=0)), device)
    guard = ReadOnlyGuard(models=(model,))
    with guard.kept():
        model.read("means").clone()
    with pytest.raises(PluginError, match="the Gaussians"), guard.kept(every_bit=True):
        model.write("opacity_logits", torch.zeros(model.count))


def test_images_are_guarded_once_they_are_fetched(device: Device) -> None:
    scene = tiny_scene()
    assert scene.points is not None
    model = GaussianModel(initial_gaussians(scene.points, TrainingSettings()), device)
    rendering = model.render(scene.train[0].camera)
    guard = of_rendering(rendering)
    with guard.kept():
        assert rendering.rgb.isfinite().all()
    assert list(rendering.fetched) == ["rgb"]
    for name in ("rgb", "depth"):  # fetched before, and within the block
        with pytest.raises(PluginError, match=f"the rendered {name}"), guard.kept():
            getattr(rendering, name).detach().zero_()
    with pytest.raises(PluginError, match="rendered alpha"), guard.kept(every_bit=True):
        rendering.alpha.detach().numpy().fill(0)
