from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
import torch

from core_rasterizer import Camera, GaussianModel, Gaussians, load_ply, open_device, save_ply
from registry import PluginError, PointCloud, SceneError, Settings, TrainingView
from registry.priors import GaussiansPrior
from registry.testing import check, tiny_scene
from stereogs_plugins.initializers.feed_forward import FeedForwardInitializer
from tests.host import TrainingSettings, initial_gaussians
from tests.stereogs_plugins.building import build

SCALE = 2.5
"""Of the fake network's coordinates, which are those of its first camera."""


class SavedSettings(Settings):
    path: Path
    """A Gaussian scene in the world of the cameras."""


class Saved(GaussiansPrior[SavedSettings]):
    """Answers like a network: relative to the first camera, in another unit, with RGB or SH."""

    calls = 0

    def estimate(self, views: Sequence[TrainingView], bounds: tuple[float, float]) -> PointCloud:
        self.calls += 1
        to_world = views[0].camera.camera_to_world.clone()
        to_world[:3, :3] *= SCALE
        world = PointCloud.of_gaussians(load_ply(self.settings.path))
        return world.transformed(torch.linalg.inv(to_world)).transformed(to_world)


def saved(path: Path, opacity: float = 0.8) -> Gaussians:
    """Save twelve Gaussians of any shape in front of the tiny scene's cameras, and a faint one."""
    generator = torch.Generator().manual_seed(4)
    means = torch.rand(13, 3, generator=generator) * 2 - 1 + torch.tensor([0.0, 0, 3])
    scales = torch.rand(13, 3, generator=generator) * 0.3 + 0.05
    opacities = torch.full((13,), opacity)
    opacities[12] = 0.003
    sh = torch.rand(13, 16, 3, generator=generator) - 0.4
    turned = torch.randn(13, 4, generator=generator)
    gaussians = Gaussians.from_points(means, means, scales, opacities, 3, turned, sh)
    save_ply(gaussians, path)
    return gaussians


def image(gaussians: Gaussians, camera: Camera) -> torch.Tensor:
    return GaussianModel(gaussians, open_device()).render(camera).rgb.detach()


def test_the_start_looks_like_the_model_of_the_prior(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    original = saved(tmp_path / "scene.ply")
    prior, scene = build(Saved, path=tmp_path / "scene.ply"), tiny_scene()
    for _ in range(2):
        points = build(FeedForwardInitializer).initialize(scene.for_training(), {"net": prior})
        assert len(points) == 12
        started = initial_gaussians(points, TrainingSettings())
        for view in (*scene.train, *scene.test):
            expected = image(original, view.camera)
            assert expected.std() > 0.1
            torch.testing.assert_close(image(started, view.camera), expected, atol=1e-3, rtol=0)
    assert prior.calls == 1


def test_it_and_its_prior_keep_the_contract(tmp_path: Path) -> None:
    saved(tmp_path / "scene.ply")
    check(Saved, path=tmp_path / "scene.ply")
    check(FeedForwardInitializer, priors={"net": build(Saved, path=tmp_path / "scene.ply")})


def test_answers_that_are_not_gaussians_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved(tmp_path / "scene.ply", opacity=0.002)
    views, bounds = tiny_scene().for_training().train, (1.0, 5.0)
    prior = build(Saved, path=tmp_path / "scene.ply")
    with pytest.raises(SceneError, match="13 Gaussians, none with an opacity"):
        build(FeedForwardInitializer).initialize(tiny_scene().for_training(), {"net": prior})
    nothing = torch.zeros(2, 3)
    for answer, message in (
        (nothing, "is a Tensor"),
        (PointCloud(nothing, nothing, facts={"a": 1}), "maps, pictures or facts"),
        (PointCloud(nothing, nothing, quaternions=torch.zeros(2, 4)), "quaternions"),
    ):
        monkeypatch.setattr(Saved, "estimate", lambda *_, answer=answer: answer)
        with pytest.raises((PluginError, SceneError), match=message):
            prior.gaussians(views, bounds)
