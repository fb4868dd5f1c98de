"""The host's own settings: the `training` section of a pipeline. Defaults are those of 3DGS."""

from __future__ import annotations

import re
from collections.abc import Mapping
from fractions import Fraction
from typing import Annotated, Any, Self

from pydantic import Field

from ..contract.component import Settings
from ..errors import PipelineError
from .schedule import moved
from .yaml_source import Node, parse

VIEWS = 3
"""What a pipeline with iterations for each training view counts with until its scene is loaded."""
PER_VIEW = re.compile(r"([1-9][0-9]{0,6}) per view")
"""How such iterations are written."""

Rate = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0)]
Positive = Annotated[int, Field(ge=1)]


_RATES = ("position", "position_final", "sh_constant", "sh_rest", "opacity", "scale", "rotation")


class LearningRates(Settings):
    """Adam's step sizes (Kerbl et al. 2023, the authors' code)."""

    position: Rate = 1.6e-4
    """Of the means at the first iteration, in units of the scene's extent."""
    position_final: Rate = 1.6e-6
    """Of the means after `position_steps`; between the two the logarithm is linear."""
    position_steps: Positive | None = None
    """Iterations until `position_final`; null means all of training."""
    sh_constant: Rate = 2.5e-3
    """Of the constant colour band."""
    sh_rest: Rate = 1.25e-4
    """Of the other colour bands."""
    opacity: Rate = 0.05
    """Of the opacity logits."""
    scale: Rate = 5e-3
    """Of the logarithms of the scales."""
    rotation: Rate = 1e-3
    """Of the quaternions."""
    final_share: Annotated[float, Field(ge=0, le=1)] = 1.0
    """What is left at the end of all rates but that of the means; half a cosine leads there."""
    views: Positive | None = None
    """Training views up to which the rates are these, where each view brings iterations; with more, all are
    lower in proportion: twice the steps, half as long. Null: they are these for any number."""

    def for_views(self, views: int) -> Self:
        """The rates for so many training views."""
        if self.views is None:
            return self
        factor = min(1.0, self.views / views)
        changed = {name: factor * getattr(self, name) for name in _RATES}
        return self.model_copy(update={**changed, "views": None})


class TrainingSettings(Settings):
    """The training loop."""

    iterations: Positive = 30_000
    """How many training views are rendered and learnt from, one each. A pipeline may say `100 per view`: the
    scene's training views then give the number, and all schedules go with it."""
    seed: Count = 0
    """Every random number of the run derives from it."""
    sh_degree: Annotated[int, Field(ge=0, le=3)] = 3
    """Highest spherical-harmonic band of the colours."""
    sh_every: Positive = 1000
    """Iterations until the next band comes into use."""
    ssim_weight: Annotated[float, Field(ge=0, le=1)] = 0.2
    """Weight of D-SSIM in the photometric loss."""
    l1_weight: Rate | None = None
    """Weight of L1 in the photometric loss; null makes it what `ssim_weight` leaves of 1 (3DGS)."""
    dilation: Rate = 0.3
    """Square pixels added to the variance of every Gaussian's picture (3DGS)."""
    compensate_dilation: bool = False
    """Lower opacities so that the dilation adds no light (Mip-Splatting, Yu et al. 2024)."""
    initial_opacity: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """Of the first Gaussians, where the initializer gives none."""
    initial_scale: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 1.0
    """Factor of the first Gaussians' distance to their neighbours, where the initializer gives no scales."""
    learning_rates: LearningRates = LearningRates()
    """Adam's step sizes."""
    fields: Positive = 1
    """Fields of Gaussians that are trained in lock-step from the same points, each with an optimizer,
    policies and random numbers of its own; losses and policies see the others. The first is scored."""
    max_gaussians: Positive | None = None
    """No densification goes beyond this number; null means no limit."""
    checkpoint_every: Count = 0
    """Iterations between checkpoints, beside those at the beginning, now and then by the clock, and at
    the end; 0 for none."""
    evaluate_every: Count | None = None
    """Iterations between evaluations of the test views, which are no training time; 0 evaluates at the
    end only; null after each quarter, if a quarter has 50 iterations or more."""

    def scaled(self, iterations: int) -> Self:
        """The same with so many iterations, and what is due during them in proportion."""
        factor = Fraction(iterations, self.iterations)
        steps = self.learning_rates.position_steps
        rates = self.learning_rates.model_dump() | {
            "position_steps": None if steps is None else moved(steps, factor)
        }
        changes = {
            "iterations": iterations,
            "sh_every": moved(self.sh_every, factor),
            "learning_rates": rates,
        }
        return self.model_validate({**self.model_dump(), **changes})


def plain_training(settings: TrainingSettings) -> dict[str, Any]:
    """Plain values for a pipeline file, every default written out.

    But for `learning_rates.views` where it is not set, as in pipelines of before there was one.
    """
    values = settings.model_dump(mode="json")
    if settings.learning_rates.views is None:
        del values["learning_rates"]["views"]
    return values


def per_view(settings: Mapping[str, Node]) -> tuple[dict[str, Node], int | None]:
    """The `training` section with a number of iterations, and how many each view brings if it says that."""
    node = settings.get("iterations")
    found = PER_VIEW.fullmatch(node.content) if node and isinstance(node.content, str) else None
    if node is None or found is None:
        return dict(settings), None
    each = int(found[1])
    return {**settings, "iterations": Node(VIEWS * each, node.place)}, each


def iterations_of_a_run(text: str) -> int:
    """Return the number of iterations in a run folder's pipeline file; 0 if it has none."""
    try:
        content = parse(text, "the run's pipeline").at(("training", "iterations")).content
    except PipelineError:
        return 0
    return content if isinstance(content, int) else 0
