"""What a plugin is: one base class a hook point, typed settings, and what each call receives.

A component *returns* what it wants (a loss, an edit, new opacities) and changes nothing itself: the
host applies the answer to parameters, optimizer moments and every component's per-Gaussian state.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, Self

import pydantic
import torch
from torch import Tensor
from typing_extensions import TypeVar

from core_rasterizer import Device, Edit, GaussianModel, Rendering

from .prior_choice import choose_prior
from .scene import PointCloud, Scene, View


class Settings(pydantic.BaseModel):
    """Base of every component's settings: immutable, unknown keys refused.

    Types are strict: a pipeline's "3" is no number and 3.0 no whole number. The text below a field
    is its documentation.
    """

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


# With a default, which `typing` offers from Python 3.13 on, `StereoPrior.choose(...)` has a full type.
SettingsType = TypeVar("SettingsType", bound=Settings, default=Settings)


@dataclass(frozen=True)
class Context:
    """What the host gives a component when it builds it.

    Args:
        name: the component's name in the pipeline.
        seed: derived from the run's seed and the name, so that toggling one component never shifts
            another's random numbers.
        device: the OpenCL device of the run.
    """

    name: str
    seed: int
    device: Device


class Component(Generic[SettingsType]):
    """Base of all plugins. A subclass may define a nested `Settings` class of its own."""

    Settings: ClassVar[type[Settings]] = Settings

    def __init__(self, settings: SettingsType, context: Context) -> None:
        self.settings = settings
        self.context = context
        self.generator = torch.Generator().manual_seed(context.seed)

    def state(self) -> dict[str, Tensor]:
        """Running state to be saved in a checkpoint, beside the random generator's."""
        return {}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take back what `state` returned."""

    def carry(self, source: Tensor, fresh: Tensor) -> None:
        """Follow a change of topology with per-Gaussian state of one's own.

        Args:
            source: `[N_new]` int64, the old index that each new Gaussian comes from.
            fresh: `[N_new]` bool, True for Gaussians that did not exist before.
        """


@dataclass
class Step:
    """One training iteration, as the components see it.

    Args:
        iteration: 1-based.
        iterations: the total number of iterations.
        scene: the whole scene.
        view: the training view of this iteration.
        rendering: the render of that view (`rgb [H, W, 3]`, `depth [H, W]`, `alpha [H, W]`; autograd).
            None while modifiers are asked, which is before the render.
        model: the Gaussians; read what is needed with `model.read(name)`, after the backward pass
            also `model.gradient(name)`.
        extent: the scene's extent in world units (`Scene.extent`).
        priors: the pipeline's prior models by name.
        render: `render(camera, *, gradient=True)` renders another camera at the current parameters,
            without modifiers, on the scene's background; gradients flow if `gradient`.
        log: records a number under a name in the run's metrics.
    """

    iteration: int
    iterations: int
    scene: Scene
    view: View
    rendering: Rendering | None
    model: GaussianModel
    extent: float
    priors: Mapping[str, Prior[Any]]
    render: Callable[..., Rendering]
    log: Callable[[str, float], None]


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

    @abstractmethod
    def load(self) -> Scene:
        """Return the scene that the settings describe. The host validates it afterwards."""


class Prior(Component[SettingsType], ABC):
    """A frozen model that estimates something from images.

    `capability` says what. Three capabilities have a base class with a fixed question and checked
    answers: `StereoPrior`, `MultiViewDepthPrior` and `MonocularDepthPrior`; any other text is free for
    plugins that agree on it. A consumer asks for a capability (`StereoPrior.choose`), the pipeline
    names the prior.
    """

    capability: ClassVar[str]

    @classmethod
    def choose(cls, priors: Mapping[str, Prior[Any]], name: str | None) -> Self:
        """The pipeline's prior of this class.

        Args:
            priors: by name, as a component is given them.
            name: which one, or None: the only one of this class.

        Raises:
            PluginError: there is none, more than one, none of that name, or one of another class.
        """
        return choose_prior(priors, cls, name)


class Initializer(Component[SettingsType], ABC):
    """Makes the points that Gaussians start from."""

    @abstractmethod
    def initialize(self, scene: Scene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return at least one point. May look at the training views only."""


class Regularizer(Component[SettingsType], ABC):
    """Adds a term to the loss. Its weight and schedule belong to the pipeline, not to it."""

    @abstractmethod
    def loss(self, step: Step) -> Tensor:
        """Return a scalar that takes part in autograd, finite."""


class Modifier(Component[SettingsType], ABC):
    """Changes the opacities of one render, for example dropout."""

    @abstractmethod
    def opacity_scale(self, step: Step) -> Tensor:
        """Return `[N]` factors >= 0 for the activated opacities of the training render."""


class Densification(Component[SettingsType], ABC):
    """Decides where Gaussians are added and removed."""

    @abstractmethod
    def refine(self, step: Step) -> Edit | None:
        """Return the edit that is due, or None. Called after the backward pass, when scheduled.

        Any edit, an empty one too, starts the densification statistics anew; None leaves them.
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


@dataclass(frozen=True)
class Unavailable:
    """A metric's answer when there is nothing to measure with: no model file, no true depth.

    Args:
        reason: one sentence, for the results.
    """

    reason: str


class ViewMetric(Component[SettingsType], ABC):
    """Scores one rendered view against whatever the scene knows about it."""

    higher_is_better: ClassVar[bool] = True
    unit: ClassVar[str] = ""

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
    def export(self, model: GaussianModel, scene: Scene, folder: Path) -> list[Path]:
        """Write into `folder`, which exists, and return the files written."""


class Report(Component[SettingsType], ABC):
    """Turns a finished run into something that a person looks at."""

    @abstractmethod
    def write(self, folder: Path, scene: Scene) -> list[Path]:
        """Read the run folder's results and renders; write into it and return the files written."""
