"""What an iteration of `weightfree_fast`'s kind asks of a device that has memory of its own."""

from __future__ import annotations

import pytest

from core_rasterizer import Device, GaussianModel, open_device
from core_rasterizer.device import Variant
from registry.testing import tiny_scene
from tests.core_rasterizer.quick_device import QuickDevice
from tests.core_rasterizer.traffic import Traffic, counted
from tests.host import Parts, Plugins, Trainer, initial_gaussians, parse_pipeline

PIPELINE = """\
name: t
scene: procedural
initializer: consistency_dense
modifiers: [{use: dropout, rate: 0.2, compensate: false}]
densification: {use: gradient_threshold, start: 4, stop: null, every: 4}
opacity: {use: gradient_aware_decay, scope: contributing}
training: {iterations: 10, sh_degree: 1, sh_every: 2}
"""
WIDTH, HEIGHT = 32, 24
"""Of the images, in pixels."""
FLOAT, CAMERA, COUNTERS = 4, 32 * 8, 4 * 8

LAUNCHES = {"cpu": 7, "gpu": 24}


def trainer_on(device: Device, text: str = PIPELINE) -> Trainer:
    pipeline = parse_pipeline(text, Plugins(), source="t.yaml")
    scene = tiny_scene()
    assert scene.points is not None
    model = GaussianModel(initial_gaussians(scene.points, pipeline.training), device)
    return Trainer(pipeline.training, Parts(pipeline, device), scene, model)


@pytest.mark.parametrize("variant", ["cpu", "gpu"])
def test_an_iteration_moves_no_image_and_waits_five_times(
    variant: Variant, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = QuickDevice(open_device(), variant, shares_memory=True)
    trainer = trainer_on(engine.as_discrete())
    counts: dict[int, Traffic] = {}
    iterations = trainer.run()
    for number in range(1, 11):
        with counted(monkeypatch) as counts[number]:
            assert next(iterations).number == number

    # Both views have been seen, scratch memory has its size, and no policy of densification is due.
    traffic = counts[3]
    gaussians = FLOAT * 64
    # Dropout's factors and decayed opacities; what decay wants to know, opacities and their gradient;
    # Adam's word on the parameters, for which the iteration after it no longer stands still.
    assert sorted(traffic.uploads) == [CAMERA, gaussians, gaussians], traffic
    sums = HEIGHT if variant == "cpu" else -(-HEIGHT // 16) * -(-WIDTH // 16)
    downloads = sorted([FLOAT, COUNTERS, 2 * FLOAT * sums, gaussians, gaussians])
    assert sorted(traffic.downloads) == downloads, traffic
    assert traffic.waits <= 5, traffic
    assert traffic.launches <= LAUNCHES[variant], traffic
    assert not traffic.fills, traffic
    # Every render used the arrays of the one before, which the last one still holds.
    assert isinstance(trainer.model, GaussianModel)
    assert not trainer.model.renderer._frames
    # An edit moves no parameters of Gaussians but those that its policy looks at. The first call of a policy,
    # in iteration 4, is also checked for writes to its inputs.
    assert trainer.model.count > 64
    assert sum(counts[8].uploads) + sum(counts[8].downloads) < 40 * FLOAT * 128

    shared = trainer_on(engine)
    assert [done.number for done in shared.run()][-1] == 10
    assert shared.model.digest() == trainer.model.digest()


def test_only_iterations_with_a_reader_store_gradients(monkeypatch: pytest.MonkeyPatch) -> None:
    every_second = PIPELINE.replace(
        "scope: contributing", "scope: contributing, every: 2, phase: 0"
    )
    trainer = trainer_on(open_device(), every_second.replace("every: 4", "every: 100"))
    with counted(monkeypatch) as traffic:
        for done in trainer.run():
            # Decay reads gradients in every second iteration, and the host looks at those of the first.
            stored = done.number == 1 or done.number % 2 == 0
            assert traffic.kernels["project_backward"] == stored
            assert traffic.kernels["project_backward_and_step"] == (not stored)
            traffic.kernels.clear()
