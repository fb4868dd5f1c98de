"""Base class of components: typed settings, a context and a random generator."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from inspect import get_annotations
from typing import TYPE_CHECKING, Any, ClassVar, Generic, get_args

import pydantic
from typing_extensions import TypeVar

from ..errors import PluginError
from .host_defaults import HostDefaults

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Device, GaussianReader

    from .rendered import Rendered
    from .scene import TrainingScene


class Settings(pydantic.BaseModel):
    """Base of every component's settings: immutable, unknown keys refused.

    Types are strict: "3" is not a number and 3.0 not an integer. The string below a field documents it.
    """

    model_config = pydantic.ConfigDict(
        extra="forbid",
        frozen=True,
        use_attribute_docstrings=True,
        defer_build=True,  # unused models are not built
    )
    renamed: ClassVar[Mapping[str, str]] = {}
    """Present names by former names; pipelines with a former name open, with a warning."""
    removed: ClassVar[Mapping[str, object]] = {}
    """Settings that no longer exist, with the value that the code now has; pipelines with this value open."""
    public: ClassVar[Collection[str]] = ()
    """Settings whose environment variables run folders and `explain` show as values. Others stay `${NAME}`,
    because they may be secret, except variables that begin with STEREOGS_."""
    _written: dict[str, tuple[Any, Any]] = pydantic.PrivateAttr(default_factory=dict)
    """Value and text, as written in the pipeline, of settings that are recorded by the text."""


# With a default (in `typing` from Python 3.13 on), `StereoPrior.choose(...)` has a full type.
SettingsType = TypeVar("SettingsType", bound=Settings, default=Settings)


def no_priors(base: type[Any]) -> Mapping[str, Any]:
    """Return no priors: `Context.priors` without a pipeline."""
    return {}


@dataclass(frozen=True)
class Context:
    """Data that the host passes to a component's constructor.

    Args:
        name: the component's name in the pipeline.
        seed: derived from the run's seed and the name, so that adding or removing a component does not
            change the random numbers of others.
        device: the OpenCL device of the run.
        at_work: returns a context in which errors are attributed to this component rather than to its
            caller; see `Prior`.
        priors: for scene loaders, returns the pipeline's priors of a base class by name, constructed on
            first use: `context.priors(PosedDepthPrior)`.
    """

    name: str
    seed: int
    device: Device
    at_work: Callable[[], AbstractContextManager[None]] = nullcontext
    priors: Callable[[type[Any]], Mapping[str, Any]] = no_priors


@dataclass(frozen=True, eq=False)
class ParameterGroup:
    """Parameters of a component that the host trains along with the Gaussians.

    Args:
        name: unique within the component.
        tensors: torch leaves that require a gradient; the same objects at every call.
        learning_rate: of Adam (`torch.optim.Adam` with its usual betas and epsilon), >= 0.
    """

    name: str
    tensors: Sequence[Tensor]
    learning_rate: float


@dataclass(frozen=True, eq=False)
class GaussianFeature:
    """Numbers of each Gaussian besides its parameters, for example of a label, that the host keeps.

    They follow each edit: a new Gaussian has those of the one that it descends from. Checkpoints and exported
    files hold them, and `Step.features` gives them in autograd.

    Args:
        name: a word of letters, digits and "_", unique in the pipeline; files have `NAME_0`, `NAME_1`, ...
        values: `[N, C]` float32, the initial numbers, finite.
        learning_rate: of Adam, >= 0; 0 keeps the numbers fixed.
    """

    name: str
    values: Tensor
    learning_rate: float = 0.0


class Component(Generic[SettingsType]):
    """Base of all components: `class Mine(Regularizer[MySettings])` has settings of type `MySettings`.

    Attributes:
        Settings: type of the settings, taken from the type argument of the base class.
        settings, context: passed to the constructor.
        generator: for all random numbers; seeded with `context.seed`, and saved in checkpoints.
    """

    Settings: ClassVar[type[Settings]] = Settings
    ablation_baseline: ClassVar[str | None] = None
    """Name of the component of the same kind that replaces this one when an ablation disables it; None: none
    does."""
    host_defaults: ClassVar[HostDefaults] = HostDefaults()
    """Defaults of settings that the host reads: `HostDefaults(start=Percent(2), every=100, weight=0.1)`."""
    needs_priors: ClassVar[tuple[str | tuple[str, ...], ...]] = ()
    """Capabilities of the priors that it uses; a nested tuple means any of these, the first preferred.
    Training starts only if the pipeline has them. The setting `prior`, if it exists, names the prior."""

    def __init_subclass__(cls, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        if "Settings" not in cls.__dict__:
            written = [
                argument
                for base in cls.__dict__.get("__orig_bases__", ())
                for argument in get_args(base)
                if isinstance(argument, type) and issubclass(argument, Settings)
            ]
            if written:
                cls.Settings = written[0]
        annotated = _own_annotation(cls, "settings")
        if isinstance(annotated, type) and not issubclass(cls.Settings, annotated):
            name = annotated.__name__
            raise PluginError(
                f"{cls.__name__} annotates `settings` as {name}, but they are {cls.Settings.__name__}",
                where=f"{cls.__module__}.{cls.__qualname__}",
                fix=f"write `class {cls.__name__}({cls.__bases__[0].__name__}[{name}])` instead",
            )

    def __init__(self, settings: SettingsType, context: Context) -> None:
        import torch

        self.settings = settings
        self.context = context
        self.generator = torch.Generator().manual_seed(context.seed)

    @classmethod
    def needs_rendered(cls, settings: SettingsType) -> tuple[Rendered, ...]:
        """Return what the host renders or collects for a component with these settings; nothing by default.

        - "normals": `step.normals`
        - "contributions": `step.contributions`
        - "other_fields": `step.others`; training has two fields or more (`training.fields`)
        - "screen_gradient": `step.model.screen_gradient()`
        - "absolute_screen_gradient": `step.model.absolute_screen_gradient()`

        For components of the training loop. What a component does not declare, it cannot use.
        """
        return ()

    def begin_training(self, scene: TrainingScene) -> None:
        """Called once for each component of the training loop, before `restore` and `parameters`."""

    def parameters(self) -> Sequence[ParameterGroup]:
        """Return parameters that take part in the loss; the host optimizes and saves them."""
        return ()

    def features(self, model: GaussianReader) -> Sequence[GaussianFeature]:
        """Return numbers per Gaussian that the host trains or keeps; called after `begin_training`.

        For components of the training loop. When a run is resumed, the saved numbers replace these.
        """
        return ()

    def state(self) -> dict[str, Tensor]:
        """Return state to save in checkpoints; generator and parameters are saved by the host."""
        return {}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore a state that `state` returned."""

    def carry(self, source: Tensor, fresh: Tensor) -> None:
        """Apply a change of topology to the component's per-Gaussian state.

        Args:
            source: `[N_new]` int64, the old index that each new Gaussian comes from.
            fresh: `[N_new]` bool, True for added Gaussians.
        """


def _own_annotation(cls: type[Any], name: str) -> Any:
    """Return the type in a class's own annotation; None without one, or if a name is not known yet."""
    written = get_annotations(cls).get(name)
    alone = type(
        cls.__name__, (), {"__annotations__": {name: written}, "__module__": cls.__module__}
    )
    try:  # other annotations may name types that only type checkers import
        return get_annotations(alone, eval_str=True)[name]
    except NameError:
        return None
