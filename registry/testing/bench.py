"""Inputs for a component, at different sizes, and a checked call of its methods."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from functools import cached_property
from time import monotonic
from typing import Any

import torch
from torch import Tensor

from core_rasterizer import Device, ExplainedError, GaussianReader, Model, photometric_loss

from .. import priors as prior_bases
from ..contract.component import Component
from ..contract.hook_points import LOSS, RENDER
from ..contract.prior import Prior
from ..contract.scene import DepthMap, PointCloud, Scene
from ..contract.step import OtherField, Step
from ..pipeline.training_settings import TrainingSettings
from ..system.memory import memory_added
from ..training.initial_model import initial_gaussians, new_model
from ..training.step import step_renderer
from .assertions import no_side_effects
from .scenes import SMALL, Size, hook_point, points_of, scene_of, step_of

_SETTINGS = TrainingSettings(iterations=100, sh_degree=1)


class Refused(Exception):
    """A component refused a degenerate input with an error that explains itself, which is allowed."""


@dataclass
class Bench:
    """Provides a component's inputs and calls its methods.

    Args:
        device: where the Gaussians live.
        priors: prior models by name.
        size: size of the scene.
        shrink: the photographs have this many times the rows and columns of the renders.
        ask: calls a prior of a capability that `registry.priors` does not have, with a scene.

    Attributes:
        seconds: total time of the component's methods so far.
        megabytes: largest growth of the process during one call; None where it cannot be measured.
    """

    device: Device
    priors: dict[str, Prior[Any]]
    size: Size = SMALL
    shrink: int = 1
    ask: Callable[[Any, Scene], Any] | None = None
    seconds: float = field(default=0.0, init=False)
    megabytes: float | None = field(default=None, init=False)

    def call(self, method: Callable[..., Any], *given: Any) -> Any:
        """Call a component's method and check that it has no side effects.

        Raises:
            Refused: it raised an `ExplainedError`, on a degenerate scene or with `shrink` > 1.
            ExplainedError: it raised one on another scene, the base class of a prior refused the answer,
                or the component changed state that the process shares.
            AssertionError: it changed its arguments.
        """
        by_name = {
            "step" if isinstance(value, Step) else f"argument {number}": value
            for number, value in enumerate(given, 1)
        }
        with no_side_effects(by_name), memory_added() as added:
            begin = monotonic()
            try:
                answer = method(*given)
            except ExplainedError as error:
                may_refuse = self.size.degenerate or self.shrink > 1
                if may_refuse and not _raised_by_prior_base(error):
                    raise Refused(str(error)) from error
                raise
            self.seconds += monotonic() - begin
        if added.megabytes is not None:
            self.megabytes = max(self.megabytes or 0.0, added.megabytes)
        return answer

    def answer(self, built: Component[Any], *given: Any) -> Any:
        """Call the method of a component's hook point (see `call`), and return its checked answer."""
        point = hook_point(type(built))
        return point.check(self.call(getattr(built, point.method), *given), *given)

    @cached_property
    def scene(self) -> Scene:
        """Three views: two for training, one for testing."""
        return scene_of(self.size)

    def points(self) -> PointCloud:
        """Return the initial points, which no camera sees if the size says so."""
        return points_of(self.size)

    def model(self) -> Model:
        """Return new Gaussians at the points."""
        return new_model(initial_gaussians(self.points(), _SETTINGS), _SETTINGS, self.device)

    def maps(self) -> dict[str, DepthMap]:
        """Return an initializer's depth of each training view: the wall, or nothing if it is hidden."""
        known = torch.full((self.size.height, self.size.width), not self.size.hidden)
        return {v.name: DepthMap(3.0 * known, known, known.float()) for v in self.scene.train}

    def kinds(self) -> dict[str, Tensor]:
        """Return two kinds of points: each even one is confirmed, each odd one hidden."""
        hidden = torch.arange(len(self.points())) % 2 == 1
        return {"confirmed": ~hidden, "hidden": hidden}

    def step(self, built: Component[Any]) -> Step:
        """Return an iteration at the stage in which a component is called."""
        stage, declared = (
            hook_point(type(built)).stage,
            frozenset(built.needs_rendered(built.settings)),
        )
        if stage == RENDER:
            step = self.before_render()
        else:
            step = self.after_render(declared) if stage == LOSS else self.after_backward(declared)
        step = replace(
            step,
            features={
                feature.name: feature.values.clone().requires_grad_(feature.learning_rate > 0)
                for feature in built.features(step.model)
            },
        )
        for name in sorted(declared & step.makers.keys()):
            step.output(name)
        step.access.declared = declared
        return step

    def before_render(self) -> Step:
        """Return an iteration before its render."""
        return self._step(self.model())

    def after_render(self, declared: Collection[str] = ()) -> Step:
        """Return an iteration after its render, with one other field.

        Args:
            declared: outputs that the component declares.
        """
        absolute = "absolute_screen_gradient" in declared
        model, other = self.model(), self.model()
        step = self._step(model)
        camera = step.sample.camera
        rendering = model.render(camera, collect_statistics=True, collect_absolute=absolute)
        render = step_renderer(other, step.sample, gradients=False)
        step.rendered(
            lambda: rendering, (OtherField(1, GaussianReader(other), render(camera), render),)
        )
        return step

    def after_backward(self, declared: Collection[str] = ()) -> Step:
        """Return an iteration after its backward pass; see `after_render`."""
        step = self.after_render(declared)
        photometric_loss(step.rendering.rgb, step.sample.target, device=self.device).backward()
        return step

    def _step(self, model: Model) -> Step:
        return step_of(
            model,
            self.scene,
            priors=self.priors,
            maps=self.maps(),
            kinds=self.kinds(),
            shrink=self.shrink,
        )


def _raised_by_prior_base(error: ExplainedError) -> bool:
    """Whether a base class of priors raised the error because of the answer, not the prior itself."""
    *_, (frame, _) = traceback.walk_tb(error.__traceback__)
    return str(frame.f_globals.get("__name__")).startswith(prior_bases.__name__)
