"""Fisher information of the Gaussians, against the full Jacobian."""

from __future__ import annotations

from dataclasses import replace

import torch

from core_rasterizer import Camera
from registry.toolkit.views import same_model
from stereogs_plugins.confidence.estimators import Fisher
from stereogs_plugins.confidence.estimators.fisher import PARAMETERS
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.confidence.trained import small


def test_the_information_is_the_diagonal_of_the_jacobians_square() -> None:
    trained = small(4)
    view = trained.scene.train[0]
    camera = Camera(view.camera.world_to_camera, 8.0, 8.0, 4.0, 3.0, 8, 6)
    views = (replace(view, camera=camera),)
    one_view = replace(trained, scene=replace(trained.scene, train=views))
    found = build(Fisher, probes=200).estimate(one_view).information

    model = same_model(trained.model)
    expected = {name: torch.zeros_like(model.read(name)) for name in PARAMETERS}
    rgb = model.render(camera).rgb
    for place in (rgb.detach() > 0).nonzero():
        model.zero_gradients()
        model.render(camera).rgb[tuple(place)].backward()
        for name in PARAMETERS:
            expected[name] += model.gradient(name) ** 2
    for name in PARAMETERS:
        scale = float(expected[name].max())
        torch.testing.assert_close(found[name], expected[name], rtol=0.5, atol=0.1 * scale)


def test_the_model_of_the_run_is_left_alone() -> None:
    trained = small()
    before = trained.model.digest()
    build(Fisher).estimate(trained)
    assert trained.model.digest() == before
    assert not trained.model.gradient("means").any()


def test_confidence_is_a_share_and_lower_where_no_camera_looked() -> None:
    trained = small()
    confidence = build(Fisher).estimate(trained)
    camera = trained.scene.train[0].camera
    map_of_seen = confidence.of(camera)
    assert map_of_seen.shape == (camera.height, camera.width)
    assert 0 <= float(map_of_seen.min()) < float(map_of_seen.max()) <= 1


def test_a_known_view_adds_less_than_a_new_one() -> None:
    trained = small()
    one, other = trained.scene.train
    only_one = replace(trained, scene=replace(trained.scene, train=(one,)))
    confidence = build(Fisher).estimate(only_one)
    assert confidence.gain(other.camera) > confidence.gain(one.camera)
    known = confidence.information_of([one.camera, other.camera])
    assert confidence.gain_beyond(known, other.camera) < confidence.gain(other.camera)
