from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
import torch

from core_rasterizer import Camera, GaussianReader, Rendering, photometric_loss
from registry import PluginError, Step
from registry.testing import check
from registry.toolkit.views import virtual_views
from stereogs_plugins.regularizers.unseen_views import (
    CycleFilteredWarping,
    DepthSmoothness,
    FieldAgreement,
    ForwardWarping,
    stereogs_register_regularizers,
)
from tests.host import Bench, TrainingSettings, pipeline_item, pipeline_of, refuse_unmet_needs
from tests.stereogs_plugins.building import build, offered


def bench_step() -> tuple[Step, Bench]:
    from core_rasterizer import open_device

    bench = Bench(open_device(), {})
    return bench.after_render(), bench


def test_the_four_are_registered_and_this_one_keeps_the_contract() -> None:
    assert offered(stereogs_register_regularizers) == {
        "cycle_filtered_warping": CycleFilteredWarping,
        "depth_smoothness": DepthSmoothness,
        "field_agreement": FieldAgreement,
        "forward_warping": ForwardWarping,
    }
    check(FieldAgreement)
    check(FieldAgreement, views="between", ssim_weight=0.5)


def test_fields_that_are_equal_agree() -> None:
    step, _ = bench_step()
    assert float(build(FieldAgreement).loss(step).detach()) == 0


def test_it_compares_the_two_renders_of_one_camera_before_one_background() -> None:
    step, bench = bench_step()
    step = replace(step, sample=replace(step.sample, background=(0.1, 0.9, 0.4)))
    moved = bench.model()
    moved.write("means", moved.read("means") + 0.2)
    asked = []

    def elsewhere(
        camera: Camera, *, background: Sequence[float] | None = None, **_: object
    ) -> Rendering:
        asked.append(camera)
        assert background is not None
        return moved.render(camera, background=background)

    other, rendering = step.others[0], step.rendering
    moved_field = type(other)(1, GaussianReader(moved), other.rendering, elsewhere)
    step.rendered(lambda: rendering, (moved_field,))
    loss = build(FieldAgreement, 3).loss(step)
    (camera,) = asked
    generator = torch.Generator().manual_seed(3)
    drawn = virtual_views.draw("box", step.scene, generator)
    assert torch.equal(camera.world_to_camera, drawn.world_to_camera)
    mine = step.render(camera, gradient=False).rgb
    with torch.no_grad():
        theirs = moved.render(camera, background=step.sample.background).rgb
    wanted = photometric_loss(mine, theirs, 0.2)  # 0.8 L1 + 0.2 D-SSIM
    assert float(loss.detach()) == pytest.approx(float(wanted), rel=1e-5)
    assert float(wanted) > 0.001


def test_a_single_field_is_refused() -> None:
    term = pipeline_item(FieldAgreement, FieldAgreement.Settings(), "agreement")
    with pytest.raises(PluginError, match="training has a single field"):
        refuse_unmet_needs(pipeline_of([term], TrainingSettings()))
