from __future__ import annotations

from core_rasterizer import GaussianModel, open_device
from registry.testing import step_of, tiny_scene
from stereogs_plugins.samplers.independent_views import IndependentViews
from tests.stereogs_plugins.building import build, some_gaussians


def test_views_come_at_random_with_their_own_camera_and_image() -> None:
    step = step_of(GaussianModel(some_gaussians([0.1], [0.5]), open_device()), tiny_scene())
    sampler = build(IndependentViews)
    samples = [sampler.sample(step, step.sample) for _ in range(200)]
    for sample in samples:
        assert sample.camera is sample.view.camera
        assert sample.target is sample.view.image
    names = [sample.view.name for sample in samples]
    assert 70 < names.count("view0") < 130
    # Without replacement in each round, as the host draws, no view could come three times in a row.
    assert any(names[i] == names[i + 1] == names[i + 2] for i in range(198))
