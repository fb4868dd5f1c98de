"""The host's own settings: the `training` section of a pipeline. Defaults are those of 3DGS."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Annotated, Any, Self

from pydantic import Field

from ..contract.component import Settings
from ..errors import PipelineError
from .schedule import rescaled
from .settings_check import validate_settings
from .yaml_source import Node, parse

VIEWS = 3
"""Number of training views of a pipeline with iterations per view, until its scene is loaded."""
FULL_VIEWS = 24
"""Number of training views up to which the `max_gaussians` of such a pipeline holds."""
PER_VIEW = re.compile(r"([1-9][0-9]{0,6}) per view")
"""Iterations per view, as a pipeline writes them."""

Rate = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0)]
Positive = Annotated[int, Field(ge=1)]

_RATES = ("position", "position_final", "sh_constant", "sh_rest", "opacity", "scale", "rotation")


class LearningRates(Settings):
    """Adam's step sizes (Kerbl et al. 2023, the authors' code)."""

    position: Rate = 1.6e-4
    """Of the means at the first iteration, in units of the scene's extent."""
    position_final: Rate = 1.6e-6
    """Of the means after `position_steps`; in between, the logarithm is linear."""
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
    """Factor, at the end of training, of all rates except that of the means; it falls as half a cosine."""
    views: Positive | None = None
    """With iterations per view: number of training views up to which these rates hold. With more views, all
    are lower in proportion: half as large for twice the views. Null: they do not depend on the views."""

    def for_views(self, views: int) -> Self:
        """Return the rates for a number of training views."""
        if self.views is None:
            return self
        return self.times(min(1.0, self.views / views)).model_copy(update={"views": None})

    def times(self, factor: float) -> Self:
        """Return the rates multiplied by a factor."""
        return self.model_copy(update={name: factor * getattr(self, name) for name in _RATES})


class TrainingSettings(Settings):
    """The training loop."""

    iterations: Positive = 30_000
    """Each renders one training view. `100 per view` multiplies by the number of the scene's training
    views, and scales all schedules."""
    seed: Count = 0
    """Seed of all random numbers of the run."""
    sh_degree: Annotated[int, Field(ge=0, le=3)] = 3
    """Highest spherical-harmonic band of the colours."""
    sh_every: Positive = 1000
    """Iterations until the next band is used."""
    ssim_weight: Annotated[float, Field(ge=0, le=1)] = 0.2
    """Weight of D-SSIM in the photometric loss."""
    l1_weight: Rate | None = None
    """Weight of L1 in the photometric loss; null means 1 - `ssim_weight` (3DGS)."""
    dilation: Rate = 0.3
    """Square pixels added to the variance of every projected Gaussian (3DGS)."""
    compensate_dilation: bool = False
    """Lower opacities so that the dilation adds no light (Mip-Splatting, Yu et al. 2024)."""
    initial_opacity: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """Of the first Gaussians, where the initializer gives none."""
    initial_scale: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 1.0
    """Factor of the first Gaussians' distance to their neighbours, where the initializer gives no scales."""
    learning_rates: LearningRates = LearningRates()
    """Adam's step sizes."""
    fields: Annotated[int, Field(ge=1, le=16)] = 1
    """Fields of Gaussians trained in lock-step from the same points, each with its own optimizer, policies
    and random numbers; losses and policies see the other fields. The first field is scored."""
    max_gaussians: Positive | None = None
    """Densification adds no Gaussians beyond this number; initial ones may be more. Null: no limit. With
    iterations per view it grows in proportion above 24 training views."""
    checkpoint_every: Count = 0
    """Iterations between checkpoints, besides those at the start, at the end and at intervals of time;
    0 for none."""
    evaluate_every: Count | None = None
    """Iterations between evaluations of the test views, which do not count as training time; 0: only at
    the end; null: after each quarter, if a quarter has 50 iterations or more."""

    def for_views(self, views: int) -> Self:
        """Return the settings with the learning rates and the limit of Gaussians for a number of views."""
        changes: dict[str, Any] = {"learning_rates": self.learning_rates.for_views(views)}
        if self.max_gaussians is not None:
            changes["max_gaussians"] = self.max_gaussians * max(views, FULL_VIEWS) // FULL_VIEWS
        return self.model_copy(update=changes)

    def scaled(self, iterations: int) -> Self:
        """Return the settings with another number of iterations, and schedules in proportion."""
        factor = Fraction(iterations, self.iterations)
        rates = self.learning_rates.model_dump()
        if rates["position_steps"] is not None:
            rates["position_steps"] = rescaled(rates["position_steps"], factor)
        changes = {"iterations": iterations, "sh_every": rescaled(self.sh_every, factor)}
        return self.model_validate({**self.model_dump(), **changes, "learning_rates": rates})


def read_training(node: Node) -> tuple[TrainingSettings, int | None]:
    """Return the settings of a checked `training` section, and its iterations per view if it has them."""
    settings = {} if node.content is None else node.content
    if not isinstance(settings, dict):
        raise node.place.error(
            f"training must be a mapping of settings, not {node.kind}",
            fix="write each setting in a line of its own below `training:`",
        )
    each = None
    written = settings.get("iterations")
    if written and (found := PER_VIEW.fullmatch(str(written.content))):
        each = int(found[1])
        settings = {**settings, "iterations": Node(VIEWS * each, written.place)}
    return validate_settings(TrainingSettings, Node(settings, node.place), "training"), each


def iterations_of_a_run(text: str) -> int:
    """Return the number of iterations in a run folder's pipeline file; 0 if it has none."""
    try:
        content = parse(text, "the run's pipeline").at(("training", "iterations")).content
    except PipelineError:
        return 0
    return content if isinstance(content, int) else 0
