from __future__ import annotations

import torch

from core_rasterizer import Adam, Edit, GaussianModel, apply_edit, open_device
from registry import Step
from registry.testing import step_of, tiny_scene
from stereogs_plugins.perturbations.held_colors import HeldColors
from tests.host import TrainingSettings, initial_gaussians, new_model
from tests.stereogs_plugins.building import build

SETTINGS = TrainingSettings(iterations=100, sh_degree=1)


def model() -> GaussianModel:
    points = tiny_scene().points
    assert points is not None
    made = new_model(initial_gaussians(points, SETTINGS), SETTINGS, open_device())
    assert isinstance(made, GaussianModel)
    return made


def held(count: int) -> torch.Tensor:
    return torch.arange(count) % 3 == 1


def step_at(model: GaussianModel, kinds: dict[str, torch.Tensor]) -> Step:
    return step_of(model, tiny_scene(), kinds=kinds)


def disturbed(model: GaussianModel) -> torch.Tensor:
    """Colours that training has changed."""
    noise = torch.randn(model.read("sh").shape, generator=torch.Generator().manual_seed(1))
    model.write("sh", model.read("sh") + noise)
    return model.read("sh")


def test_only_descendants_of_the_kinds_go_back() -> None:
    gaussians, component = model(), build(HeldColors, kinds=["hidden", "margin"])
    nothing = torch.zeros(gaussians.count, dtype=torch.bool)
    kinds = {"hidden": held(gaussians.count), "margin": nothing.clone(), "confirmed": ~nothing}
    kinds["margin"][0] = True
    first = gaussians.read("sh").clone()
    assert not component.offsets(step_at(gaussians, kinds))["sh"].any()
    later = disturbed(gaussians)
    after = later + component.offsets(step_at(gaussians, kinds))["sh"]
    back = kinds["hidden"] | kinds["margin"]
    torch.testing.assert_close(after[back], first[back])
    assert torch.equal(after[~back], later[~back])


def test_what_the_initializer_does_not_tell_apart_is_not_held() -> None:
    gaussians, component = model(), build(HeldColors)
    for kinds in ({}, {"confirmed": held(gaussians.count)}):
        assert component.offsets(step_at(gaussians, kinds)) == {}
        assert component.state() == {}


def test_parts_of_a_split_gaussian_take_its_first_colours() -> None:
    gaussians, component = model(), build(HeldColors)
    count = gaussians.count
    first = gaussians.read("sh").clone()
    component.offsets(step_at(gaussians, {"hidden": held(count)}))
    disturbed(gaussians)
    edit = Edit(split=held(count))
    carried = apply_edit(gaussians, Adam(gaussians), edit, torch.Generator().manual_seed(0))
    component.carry(carried.source, carried.fresh)
    kinds = {"hidden": held(count)[carried.source]}
    after = gaussians.read("sh") + component.offsets(step_at(gaussians, kinds))["sh"]
    descendants = kinds["hidden"]
    assert gaussians.count > count
    torch.testing.assert_close(after[descendants], first[carried.source][descendants])
