"""Where a component is asked: scenes and Gaussians made anew for every question, and a watch over it."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from time import monotonic
from typing import Any

import torch
from torch import Tensor

from core_rasterizer import Device, ExplainedError, GaussianModel, photometric_loss

from .. import priors as capabilities
from ..contract.maps import DepthMap
from ..contract.prior import Prior
from ..contract.scene import PointCloud, Scene
from ..contract.step import OtherField, Step
from ..pipeline.training_settings import TrainingSettings
from ..system.memory import memory_added
from ..training.initial_model import initial_gaussians, new_model
from ..training.step_rendering import StepRenderer
from .scenes import SMALL, Size, points_of, scene_of, step_of
from .watching import by_itself, untouched

_SETTINGS = TrainingSettings(iterations=100, sh_degree=1)


class Refusal(Exception):
    """A component refused a question with an error that explains itself.

    Args:
        error: what it raised.
    """

    def __init__(self, error: ExplainedError) -> None:
        super().__init__(str(error))
        self.error = error


def _raised_by_a_check(error: ExplainedError) -> bool:
    """Whether it was a base class of priors that refused the answer, and not the prior the question."""
    *_, (frame, _) = traceback.walk_tb(error.__traceback__)
    return str(frame.f_globals.get("__name__")).startswith(capabilities.__name__)


@dataclass(frozen=True, eq=False)
class Moment:
    """One moment of an iteration, and the Gaussians behind what the component sees."""

    step: Step
    model: GaussianModel


@dataclass
class Bench:
    """Where a component is tried.

    Args:
        device: where the Gaussians live.
        priors: what components are given.
        size: how large the scene is.
        shrink: renders have so many times fewer columns and rows than photographs, as samplers may ask.

    Attributes:
        seconds: what the component's own methods took so far.
        megabytes: the most that one of them added to the process's memory; None where nobody counts.
    """

    device: Device
    priors: dict[str, Prior[Any]]
    size: Size = SMALL
    shrink: int = 1
    seconds: float = field(default=0.0, init=False)
    megabytes: float | None = field(default=None, init=False)

    def ask(self, method: Callable[..., Any], *given: Any) -> Any:
        """Call a component's method as the host does, and see that it leaves all else alone.

        Raises:
            Refusal: it raised an error that explains itself.
            ExplainedError: the host's base class of a prior refuses the answer.
            AssertionError: it changed what it was given, or something that the whole process shares.
        """
        by_name = {
            "step" if isinstance(value, Step) else f"argument {number}": value
            for number, value in enumerate(given, 1)
        }
        with untouched(by_name), by_itself(), memory_added() as added:
            begin = monotonic()
            try:
                answer = method(*given)
            except ExplainedError as error:
                if _raised_by_a_check(error):
                    raise
                raise Refusal(error) from error
            self.seconds += monotonic() - begin
        if added.megabytes is not None:
            self.megabytes = max(self.megabytes or 0.0, added.megabytes)
        return answer

    @cached_property
    def scene(self) -> Scene:
        """Three views, two to train and one to test."""
        return scene_of(self.size)

    def points(self) -> PointCloud:
        """What Gaussians start from: the scene's points, or some that no camera sees."""
        return points_of(self.size)

    def model(self) -> GaussianModel:
        """Gaussians at the points."""
        return new_model(initial_gaussians(self.points(), _SETTINGS), _SETTINGS, self.device)

    def maps(self) -> dict[str, DepthMap]:
        """What an initializer could know of the training views: a wall, or nothing if all is hidden."""
        return {view.name: self._map() for view in self.scene.train}

    def _map(self) -> DepthMap:
        known = torch.full((self.size.height, self.size.width), not self.size.hidden)
        return DepthMap(3.0 * known, known, known.float())

    def kinds(self) -> dict[str, Tensor]:
        """Every second point is measured, the others are guessed."""
        guessed = torch.arange(len(self.points())) % 2 == 1
        return {"confirmed": ~guessed, "hidden": guessed}

    def begun(self) -> Moment:
        """Before the render."""
        model = self.model()
        step = step_of(
            model,
            self.scene,
            priors=self.priors,
            maps=self.maps(),
            kinds=self.kinds(),
            shrink=self.shrink,
        )
        return Moment(step, model)

    def rendered(self, *, absolute: bool = False) -> Moment:
        """After the render; there is one other field.

        Args:
            absolute: collect absolute screen gradients too.
        """
        moment = self.begun()
        step = moment.step
        rendering = moment.model.render(
            step.sample.camera, collect_statistics=True, collect_absolute=absolute
        )
        other = self.model()
        look = StepRenderer(other, step.sample, gradients=False)
        seen = OtherField(1, other.reader(), look(step.sample.camera), look)
        step.rendered(lambda: rendering, (seen,))
        return moment

    def differentiated(self, *, absolute: bool = False) -> Moment:
        """After the backward pass; see `rendered`."""
        moment = self.rendered(absolute=absolute)
        rgb, target = moment.step.rendering.rgb, moment.step.sample.target
        photometric_loss(rgb, target, device=self.device).backward()
        return moment
