"""Failures that stop an iteration before the optimizer step, and the component that is named."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

import registry as r
from core_rasterizer import Device, Edit, ExplainedError, MemoryBudgetError
from registry.testing import tiny_scene
from registry.training.initial_model import initial_gaussians, new_model
from registry.training.trainer import Trainer
from tests.host import Parts, Plugins, parse_pipeline
from tests.registry.toy_extension_points import ToyExposure
from tests.registry.toy_plugin import ToyGrowth

BASE = "name: t\nscene: toy_scene\ninitializer: toy_points\n"


@pytest.fixture
def fail(extension_points: Plugins, device: Device) -> Any:
    """Return a function that trains until an iteration fails, and returns the error.

    It checks that the failed iteration did not change the Gaussians.
    """

    def fail(text: str) -> ExplainedError:
        settings = ["training.iterations=3", "training.sh_degree=0"]
        pipeline = parse_pipeline(
            BASE + text, extension_points, source="p.yaml", overrides=settings
        )
        scene = tiny_scene()
        assert scene.points is not None
        gaussians = initial_gaussians(scene.points, pipeline.training)
        model = new_model(gaussians, pipeline.training, device)
        before = model.digest()
        try:
            for _ in Trainer(pipeline.training, Parts(pipeline, device), scene, model).run():
                before = model.digest()
        except ExplainedError as error:
            assert model.digest() == before
            return error
        raise AssertionError("nothing failed")

    return fail


TWO = """\
regularizers:
  - toy_shape
  - {use: toy_term, fault: FAULT, start: 2, step: STEP}
"""


@pytest.mark.parametrize("step", ["together", "alone"])
@pytest.mark.parametrize(
    ("fault", "what", "tensor"),
    [("gradient", "undefined gradient", "alpha[0, 0]"), ("backward", "no way back", "")],
)
def test_a_term_with_an_undefined_gradient_is_named(
    fail: Any, step: str, fault: str, what: str, tensor: str
) -> None:
    error = fail(TWO.replace("FAULT", fault).replace("STEP", step))
    assert what in error.what
    assert tensor in error.where
    assert "regularizer 'toy_term'" in error.where
    assert "p.yaml:6, iteration 2" in error.where


@pytest.mark.parametrize(
    ("raised", "expected", "what"),
    [
        (ValueError("once"), ValueError, "once"),
        (SystemExit(1), r.RunError, "the backward pass ended with SystemExit"),
    ],
)
def test_a_failure_that_no_term_repeats_is_raised_as_it_is(
    fail: Any, monkeypatch: Any, raised: BaseException, expected: type[Exception], what: str
) -> None:
    left = [raised]

    def once(gradient: Tensor) -> None:
        if left:
            raise left.pop()

    def loss(self: object, step: r.Step) -> Tensor:
        alpha = step.rendering.alpha.mean()
        alpha.register_hook(once)
        return alpha

    monkeypatch.setattr("tests.registry.toy_plugin.ToyTerm.loss", loss)
    with pytest.raises(expected, match=what):
        raise fail("regularizers: [toy_term]\n")


def test_a_loss_on_parameters_names_the_gaussian(fail: Any, monkeypatch: Any) -> None:
    def loss(self: object, step: r.Step) -> Tensor:
        return (step.parameter("opacities") * 0).sqrt().sum()

    monkeypatch.setattr("tests.registry.toy_extension_points.ToyShape.loss", loss)
    error = fail("regularizers: [toy_term, toy_shape]\n")
    assert "the parameter 'opacities'" in error.what
    assert "[0]; in regularizer 'toy_shape'" in error.where
    assert "p.yaml:4, iteration 1" in error.where


def test_an_appearance_with_an_undefined_gradient_is_named(fail: Any, monkeypatch: Any) -> None:
    colors = ToyExposure.colors

    def broken(self: ToyExposure, step: r.Step, rgb: Tensor) -> Tensor:
        return colors(self, step, rgb) + (rgb * 0).sqrt()

    text = "appearances: [toy_exposure, {use: toy_exposure, name: second}]\n"
    text += "regularizers: [toy_term]\n"
    monkeypatch.setattr(ToyExposure, "colors", broken)
    error = fail(text)
    assert "undefined gradient" in error.what
    assert "appearance 'toy_exposure'" in error.where
    assert "p.yaml:4" in error.where


def test_a_term_made_infinite_by_its_weight_is_named(fail: Any) -> None:
    error = fail("regularizers: [toy_shape, {use: toy_term, weight: 1.0e+39}]\n")
    assert "times its weight" in error.what
    assert "regularizer 'toy_term'" in error.where


def test_a_failure_of_the_engine_blames_no_component(fail: Any, monkeypatch: Any) -> None:
    def refuse(*arguments: object, **options: object) -> None:
        raise MemoryBudgetError("too much", where="60 Gaussians", fix="less")

    monkeypatch.setattr("core_rasterizer.raster.Renderer.begin_backward", refuse)
    error = fail("regularizers: [toy_term]\n")
    assert (error.what, error.where) == ("too much", "60 Gaussians; iteration 1")
    monkeypatch.setattr("core_rasterizer.GaussianModel.render", refuse)
    assert fail("regularizers: [toy_term]\n").where == "60 Gaussians; iteration 1"


def test_an_edit_that_removes_all_gaussians_names_its_policy(fail: Any, monkeypatch: Any) -> None:
    def refine(self: object, step: r.Step) -> Edit:
        return Edit(prune=torch.ones(step.model.count, dtype=torch.bool))

    monkeypatch.setattr(ToyGrowth, "refine", refine)
    error = fail("densification: toy_growth\n")
    assert error.what == "the edit would remove all 60 Gaussians"
    assert "densification 'toy_growth'" in error.where


def test_a_parameter_of_a_component_is_named_with_its_index(fail: Any, monkeypatch: Any) -> None:
    colors = ToyExposure.colors

    def broken(self: ToyExposure, step: r.Step, rgb: Tensor) -> Tensor:
        return colors(self, step, rgb) + (self.factor * 0).sqrt() * rgb.detach()

    monkeypatch.setattr(ToyExposure, "colors", broken)
    error = fail("appearances: [toy_exposure]\n")
    assert "the gradient of its parameters is not finite in 1 values" in error.what
    assert "factor, tensor 0: []; in appearance 'toy_exposure'" in error.where
