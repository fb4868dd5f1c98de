"""One base class a hook point: what a plugin derives from, and what it answers.

A component *returns* what it wants (a loss, an edit, new opacities) and changes nothing itself: the
host applies the answer to parameters, optimizer moments and every component's per-Gaussian state.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from .component import Component, SettingsType

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Edit, GaussianReader, Rendering

    from ..events import IterationDone, RunEnded, RunStarted, ViewsScored
    from .prior import Prior
    from .scene import PointCloud, Scene, TrainingScene, View
    from .step import Sample, Step


class SceneLoader(Component[SettingsType], ABC):
    """Reads photographs and cameras.

    `recognized_by` says what a folder of this format holds, for people, for example
    "transforms.json"; a loader that leaves it empty is never guessed.
    """

    recognized_by: ClassVar[str] = ""

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Whether a folder, which exists, holds what `recognized_by` says; `stereogs check` asks."""
        return False

    @classmethod
    def demo_settings(cls, folder: Path) -> Mapping[str, Any] | None:
        """Settings beside `path` with which `stereogs demo` reads a folder that this loader recognizes.

        None where a few training views would not be trained in minutes, or nothing could be scored.
        """
        return None

    @abstractmethod
    def load(self) -> Scene:
        """Return the scene that the settings describe. The host validates it afterwards."""


class Initializer(Component[SettingsType], ABC):
    """Makes the points that Gaussians start from."""

    @abstractmethod
    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return at least one point."""


class Sampler(Component[SettingsType], ABC):
    """Chooses or changes what an iteration learns from: the view, its camera, target, background."""

    @abstractmethod
    def sample(self, step: Step, sample: Sample) -> Sample:
        """Return the sample, changed or not.

        Args:
            step: before the render.
            sample: what the host drew, or what the sampler before this one returned.
        """


class Appearance(Component[SettingsType], ABC):
    """Changes the rendered colours before they are compared, for example by a photograph's exposure."""

    @abstractmethod
    def colors(self, step: Step, rgb: Tensor) -> Tensor:
        """Return `[H, W, 3]` colours in autograd.

        Args:
            rgb: the render's, `[H, W, 3]`, or what the appearance before this one returned.
        """


class Regularizer(Component[SettingsType], ABC):
    """Adds a term to the loss. Its weight and schedule belong to the pipeline, not to it."""

    @property
    def moves(self) -> Collection[str] | None:
        """Parameter groups that a step of this term alone moves (`step: alone`); None means all.

        Of the names in `core_rasterizer.layout.PARAMETER_GROUPS`. The others keep their values and
        their moments.
        """
        return None

    @abstractmethod
    def loss(self, step: Step) -> Tensor:
        """Return a scalar that takes part in autograd, finite.

        With `step: alone` it is asked before the iteration's own render: `step.rendering` is then
        made when it is first looked at, without modifiers.
        """


class Modifier(Component[SettingsType], ABC):
    """Changes the opacities of one render, for example dropout."""

    @abstractmethod
    def opacity_scale(self, step: Step) -> Tensor:
        """Return `[N]` factors >= 0 for the activated opacities of the training render."""


class Densification(Component[SettingsType], ABC):
    """Decides where Gaussians are added, split, moved and removed."""

    @property
    def absolute_gradients(self) -> bool:
        """Whether it asks for `model.absolute_screen_gradient()`, collected for those who say so."""
        return False

    @abstractmethod
    def refine(self, step: Step) -> Edit | None:
        """Return the edit that is due, or None. Called after the backward pass, when scheduled.

        Any edit, an empty one too, starts the densification statistics anew; None leaves them. In the
        last iteration the host leaves out what an edit adds: nothing would train it.
        """


@dataclass(frozen=True, eq=False)
class OpacityUpdate:
    """New activated opacities.

    Args:
        opacities: `[N]` float32 in [0, 1]; the host stores logit(clamp(opacities, 1e-6, 1 - 1e-6)).
        reset_moments: also zero the optimizer's moments of the opacities.
    """

    opacities: Tensor
    reset_moments: bool = False


class OpacityPolicy(Component[SettingsType], ABC):
    """Keeps opacities honest: resets or decays them."""

    @abstractmethod
    def update(self, step: Step) -> OpacityUpdate | None:
        """Return the update that is due, or None. Called after the backward pass, when scheduled."""


class Perturbation(Component[SettingsType], ABC):
    """Moves parameters after the optimizer's step, for example by noise."""

    @abstractmethod
    def offsets(self, step: Step) -> Mapping[str, Tensor]:
        """Return what is to be added, by parameter name, in the shapes of `model.read`; may be empty."""


@dataclass(frozen=True)
class Unavailable:
    """A metric's answer when there is nothing to measure with: no model file, no true depth.

    Args:
        reason: one sentence, for the results.
    """

    reason: str


AverageErrorRole = Literal[
    "peak_signal_to_noise_ratio", "structural_similarity", "perceptual_distance"
]
"""Which of the three parts of the average error AVGE a metric can be."""


class ViewMetric(Component[SettingsType], ABC):
    """Scores one rendered view against whatever the scene knows about it."""

    higher_is_better: ClassVar[bool] = True
    unit: ClassVar[str] = ""
    equal_images_are_best: ClassVar[bool] = True
    """Whether no render scores better than one that equals the photograph; `registry.testing` looks."""
    takes_long: ClassVar[bool] = False
    """Whether it is measured once, of test views at the end, and not while training goes on."""
    average_error_role: ClassVar[AverageErrorRole | None] = None
    """The average error takes the pipeline's first metric of each role; None: never this one."""

    @abstractmethod
    def measure_view(self, rendering: Rendering, view: View, scene: Scene) -> float | Unavailable:
        """Return the score of a render of `view`, without gradients, colours in [0, 1]."""


class Metric(ViewMetric[SettingsType]):
    """Scores one rendered image against its photograph."""

    @abstractmethod
    def measure(
        self, rendered: Tensor, photograph: Tensor, mask: Tensor | None
    ) -> float | Unavailable:
        """Return the score of `rendered` `[H, W, 3]` in [0, 1] against `photograph`, same shape.

        Args:
            mask: `[H, W]` bool, True where pixels count; None where all do.
        """

    def measure_view(self, rendering: Rendering, view: View, scene: Scene) -> float | Unavailable:
        """`measure` the view's colours."""
        return self.measure(rendering.rgb, view.image, view.mask)


class Exporter(Component[SettingsType], ABC):
    """Writes the trained Gaussians for other programs."""

    @abstractmethod
    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write into `folder`, which exists, and return the files written.

        Args:
            model: the Gaussians, to be read.
        """


class Report(Component[SettingsType], ABC):
    """Turns a finished run into something that a person looks at."""

    @abstractmethod
    def write(self, folder: Path, scene: Scene) -> list[Path]:
        """Read the run folder's results and renders; write into it and return the files written."""


class Observer(Component[SettingsType]):
    """Is told how a run goes, for example to log it; answers nothing and can change nothing.

    A run with it ends in the same bits as one without. What an observer does not want to hear of it
    leaves out. One that fails ends the run.
    """

    def started(self, run: RunStarted) -> None:
        """Hear that a run begins, or goes on; once, before anything else."""

    def iterated(self, done: IterationDone) -> None:
        """Hear of an iteration that is complete, when due by `start`, `stop` and `every`."""

    def evaluated(self, scored: ViewsScored) -> None:
        """Hear the scores: with `training.evaluate_every` while training goes on, and at the end."""

    def ended(self, run: RunEnded) -> None:
        """Hear that the run is done, was stopped or failed: close what is open. Told once, at last.

        It is told after an error of this observer too, but not to one whose `started` failed.
        """
