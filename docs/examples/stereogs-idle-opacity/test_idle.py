"""Tests by the author of a plugin: the contract, and the purpose of the component."""

import torch
from stereogs_idle_opacity import IdleFade, IdleFadeSettings

from core_rasterizer import GaussianModel, Gaussians, open_device
from stereogs import api
from stereogs.testing import check, step_of, tiny_scene


def test_it_keeps_the_contract() -> None:
    check(IdleFade, patience=2)


def test_only_what_stays_untouched_fades_and_only_after_a_while() -> None:
    scene, device = tiny_scene(), open_device()
    positions = torch.tensor([[0.0, 0.0, 3.0], [0.0, 0.0, -3.0]])  # in view, behind the camera
    grey, size = torch.full((2, 3), 0.5), torch.full((2,), 0.3)
    model = GaussianModel(Gaussians.from_points(positions, grey, size, size, 0), device)
    rendering = model.render(scene.train[0].camera)
    rendering.rgb.mean().backward()
    step = step_of(model, scene, rendering=rendering)
    policy = IdleFade(IdleFadeSettings(patience=2), api.Context("idle", 0, device))
    faded = [policy.update(step).opacities / model.opacities() for _ in range(4)]
    expected = [[1.0, 1.0], [1.0, 1.0], [1.0, 0.95], [1.0, 0.95]]
    torch.testing.assert_close(torch.stack(faded), torch.tensor(expected))
