"""Base classes of components, one for each hook point.

A component *returns* a result (a loss, an edit, new opacities) and changes nothing itself: the host
applies the result to parameters, optimizer moments and every component's per-Gaussian state.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from ..errors import SceneError
from .component import Component, Settings, SettingsType

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Edit, GaussianReader, Rendering

    from ..confidence import Trained
    from ..events import IterationDone, RunEnded, RunStarted, ViewsScored
    from .prior import Prior
    from .scene import PointCloud, Scene, TrainingScene, View
    from .step import Sample, Step


class SceneLoader(Component[SettingsType], ABC):
    """Reads photographs and cameras."""

    recognized_by: ClassVar[str] = ""
    """Content of a folder of this format, for messages, for example "transforms.json". A loader that
    leaves it empty is not considered when a folder's format is unknown."""

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Whether an existing folder has the content in `recognized_by`; used by `stereogs check`."""
        return False

    @classmethod
    def within(cls, settings: SettingsType, cpu_seconds: float) -> SettingsType:
        """Return settings that load in about this time, perhaps a poorer scene; the given ones by default.

        `train --seconds` calls it before `load`, and keeps settings that the command line names.
        """
        return settings

    @classmethod
    def priors_of(cls, settings: SettingsType) -> Mapping[str, str]:
        """Return the priors that the settings name, with the capability of each; none by default.

        The host adds those that are installed and not in the pipeline. `load` gets them from
        `context.priors`.
        """
        return {}

    @abstractmethod
    def load(self) -> Scene:
        """Return the scene that the settings describe, in the coordinates of its files.

        The host validates it, and trains in a frame of its own (`TrainingScene.frame`).
        """


IN_MEMORY = "in_memory"
"""Name of `InMemoryScene` in a pipeline. The host offers it, not a plugin."""


class InMemoryScene(SceneLoader[Settings]):
    """Stands for a scene that was passed as an object and is not in a file."""

    def load(self) -> Scene:
        """Raise a SceneError: the caller must pass the scene again."""
        raise SceneError(
            "the pipeline names no photographs: its scene was made in Python",
            where=f"scene: {IN_MEMORY}",
            fix="pass the scene too, stereogs.train(pipeline, scene=...) or "
            "stereogs.open_run(folder, scene=...); or name a loader, scene: {use: ..., path: ...}",
        )


class Initializer(Component[SettingsType], ABC):
    """Makes the initial points."""

    @abstractmethod
    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return at least one point."""


class Sampler(Component[SettingsType], ABC):
    """Chooses or changes an iteration's training sample: the view, its camera, target, background."""

    @abstractmethod
    def sample(self, step: Step, sample: Sample) -> Sample:
        """Return the sample, changed or not.

        Args:
            step: before the render.
            sample: drawn by the host, or returned by the previous sampler.
        """


class Appearance(Component[SettingsType], ABC):
    """Changes the rendered colours before they are compared, for example by a photograph's exposure."""

    @abstractmethod
    def colors(self, step: Step, rgb: Tensor) -> Tensor:
        """Return `[H, W, 3]` colours in autograd.

        Args:
            rgb: `[H, W, 3]`, the render's, or returned by the previous appearance.
        """


class Regularizer(Component[SettingsType], ABC):
    """Adds a term to the loss; the pipeline sets its weight and schedule."""

    @property
    def moves(self) -> Collection[str] | None:
        """Parameter groups that a step of this term alone (`step: alone`) moves; None means all.

        Names from `core_rasterizer.layout.PARAMETER_GROUPS`. Other groups keep their values and moments.
        """
        return None

    @abstractmethod
    def loss(self, step: Step) -> Tensor:
        """Return a finite scalar in autograd.

        With `step: alone` it is called before the iteration's own render: `step.rendering` is then
        rendered on first access, without modifiers.
        """


class Modifier(Component[SettingsType], ABC):
    """Changes the opacities of one render, for example dropout."""

    @abstractmethod
    def opacity_scale(self, step: Step) -> Tensor:
        """Return `[N]` factors >= 0 for the activated opacities of the training render."""


class Densification(Component[SettingsType], ABC):
    """Decides where Gaussians are added, split, moved and removed."""

    @abstractmethod
    def refine(self, step: Step) -> Edit | None:
        """Return the edit that is due, or None. Called after the backward pass, when scheduled.

        Any edit, even an empty one, resets the densification statistics; None keeps them. In the last
        iteration the host omits the Gaussians that an edit adds: they would not be trained.
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
    """Resets or decays opacities."""

    @abstractmethod
    def update(self, step: Step) -> OpacityUpdate | None:
        """Return the update that is due, or None. Called after the backward pass, when scheduled."""


class Perturbation(Component[SettingsType], ABC):
    """Moves parameters after the optimizer's step, for example by noise."""

    @abstractmethod
    def offsets(self, step: Step) -> Mapping[str, Tensor]:
        """Return tensors to add, by parameter name, in the shapes of `model.read`; may be empty."""


@dataclass(frozen=True)
class Unavailable:
    """A metric's result if it cannot measure, for example without a model file or true depth.

    Args:
        reason: one sentence, for the results.
    """

    reason: str


AverageErrorRole = Literal[
    "peak_signal_to_noise_ratio", "structural_similarity", "perceptual_distance"
]
"""Which of the three parts of the average error AVGE a metric can be."""


class ViewMetric(Component[SettingsType], ABC):
    """Scores one rendered view against any data of the scene."""

    higher_is_better: ClassVar[bool] = True
    unit: ClassVar[str] = ""
    equal_images_are_best: ClassVar[bool] = True
    """Whether a render equal to the photograph has the best score; checked by `registry.testing`."""
    takes_long: ClassVar[bool] = False
    """Whether it is measured only once, on test views after training."""
    average_error_role: ClassVar[AverageErrorRole | None] = None
    """The average error uses the pipeline's first metric of each role; None: not part of it."""

    def begin_scoring(self, trained: Trained) -> None:
        """Called before the scores after training; a metric may keep `trained` for `measure_view`."""

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
    """Writes the trained Gaussians for other programs, in the coordinates of the scene's files."""

    @abstractmethod
    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write into `folder`, which exists, and return the files written.

        Model and scene are in those coordinates; `model.gaussians()` has means in float64.
        """


class Report(Component[SettingsType], ABC):
    """Writes a page or picture about a finished run."""

    @abstractmethod
    def write(self, folder: Path, scene: Scene) -> list[Path]:
        """Read the run folder's results and renders; write into it and return the files written.

        The scene is in the frame of training, as are the Gaussians of `registry.runs.trained_gaussians`.
        """


class Observer(Component[SettingsType]):
    """Receives the events of a run, for example to log them; cannot change the run.

    A run has the same bits with and without it. All methods are optional. An error in one ends the run.
    """

    def started(self, run: RunStarted) -> None:
        """Called once, first, when a run begins or is resumed."""

    def iterated(self, done: IterationDone) -> None:
        """Called after an iteration, when due by `start`, `stop` and `every`."""

    def evaluated(self, scored: ViewsScored) -> None:
        """Called with scores: during training with `training.evaluate_every`, and at the end."""

    def ended(self, run: RunEnded) -> None:
        """Called once, last, when the run has finished, was stopped or failed; close open resources.

        Also called after an error of this observer, except in `started`.
        """
