from __future__ import annotations

import torch

from core_rasterizer import GaussianModel, Gaussians, open_device
from registry.testing import step_of, tiny_scene
from stereogs_plugins.modifiers.dropout import Dropout
from stereogs_plugins.opacity.expected_opacity import ExpectedOpacity
from tests.stereogs_plugins.building import build, some_gaussians, step_with


def test_multiplies_by_what_is_left_and_takes_no_step() -> None:
    step = step_with(some_gaussians([0.05, 0.05], [0.8, 0.1]))
    update = build(ExpectedOpacity, rate=0.2).update(step)
    torch.testing.assert_close(update.opacities, torch.tensor([0.64, 0.08]))
    assert update.reset_moments


def test_shows_nearly_the_mean_of_renders_with_dropout() -> None:
    """The paper's reason for it, on faint Gaussians that overlap."""
    scene = tiny_scene()
    assert scene.points is not None
    points = scene.points
    count = len(points)
    gaussians = Gaussians.from_points(
        points.positions, points.colors, torch.full((count,), 0.3), torch.full((count,), 0.3), 0
    )
    model = GaussianModel(gaussians, open_device())
    step, camera = step_of(model, scene), scene.train[0].camera
    dropout = build(Dropout, rate=0.2, compensate=False)
    with torch.no_grad():
        many = [
            model.render(camera, opacity_scale=dropout.opacity_scale(step)).rgb for _ in range(60)
        ]
        mean, whole = torch.stack(many).mean(0), model.render(camera).rgb
        expected = build(ExpectedOpacity, rate=0.2).update(step).opacities
        model.write("opacity_logits", expected.logit())
        once = model.render(camera).rgb
    assert float((once - mean).abs().mean()) < 0.25 * float((whole - mean).abs().mean())
