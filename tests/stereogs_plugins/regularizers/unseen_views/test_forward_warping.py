from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from core_rasterizer import Camera, Rendering, open_device, photometric_loss
from registry import PluginError
from registry.priors import DepthMap
from registry.toolkit.views import virtual_views
from stereogs_plugins.regularizers.unseen_views import ForwardWarping
from stereogs_plugins.regularizers.unseen_views.forward_warping import forward_splat
from tests.host import Bench
from tests.stereogs_plugins.building import build


def test_it_compares_with_the_nearest_photograph_where_that_reaches() -> None:
    logged: dict[str, float] = {}
    step = replace(Bench(open_device(), {}).after_render(), log=logged.__setitem__)
    loss = build(ForwardWarping, 4).loss(step)
    camera = virtual_views.draw("box", step.scene, torch.Generator().manual_seed(4))
    near = min(step.scene.train, key=lambda v: float((v.camera.center - camera.center).norm()))
    known = step.maps[near.name]
    warped, seen = forward_splat(near.camera, near.image, known.depth, known.valid, camera)
    assert 0 < int(seen.sum()) < seen.numel()
    assert logged == {"under test_seen": pytest.approx(float(seen.float().mean()))}
    rendered = step.render(camera, gradient=False).rgb
    rendered[~seen], warped[~seen] = 1.0, 1.0
    wanted = photometric_loss(rendered, warped, 0.8)  # MVPGS: 0.2 L1 + 0.8 D-SSIM
    assert float(loss.detach()) == pytest.approx(float(wanted), rel=1e-5)


def test_a_render_that_shows_the_warped_photograph_costs_nothing() -> None:
    step = Bench(open_device(), {}).after_render()

    def perfect(camera: Camera, **_: object) -> Rendering:
        near = min(step.scene.train, key=lambda v: float((v.camera.center - camera.center).norm()))
        known = step.maps[near.name]
        image, seen = forward_splat(near.camera, near.image, known.depth, known.valid, camera)
        image[~seen] = torch.rand(int((~seen).sum()), 3)  # holes count nothing
        return Rendering(image, image[..., 0], image[..., 0])

    step = replace(step, render=perfect)
    assert float(build(ForwardWarping).loss(step)) == 0


def test_without_maps_it_is_refused_and_empty_ones_teach_nothing() -> None:
    step = Bench(open_device(), {}).after_render()
    maps = step.maps
    step = replace(step, maps={})
    with pytest.raises(PluginError, match="no depth maps"):
        build(ForwardWarping).loss(step)
    empty = {
        name: DepthMap(torch.zeros_like(m.depth), torch.zeros_like(m.valid), m.confidence * 0)
        for name, m in maps.items()
    }
    step = replace(step, maps=empty)
    assert float(build(ForwardWarping).loss(step)) == 0
