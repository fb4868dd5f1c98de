"""What every plugin is built from: typed settings, a context, and a random generator of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, get_args

import pydantic
from typing_extensions import TypeVar

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Device

    from .scene import TrainingScene


class Settings(pydantic.BaseModel):
    """Base of every component's settings: immutable, unknown keys refused.

    Types are strict: a pipeline's "3" is no number and 3.0 no whole number. The text below a field
    is its documentation.
    """

    model_config = pydantic.ConfigDict(
        extra="forbid",
        frozen=True,
        use_attribute_docstrings=True,
        defer_build=True,  # what nobody validates with is not built
    )


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
        at_work: a block within which errors are this component's, and not those of whoever asks it: for
            priors, see `Prior`.
    """

    name: str
    seed: int
    device: Device
    at_work: Callable[[], AbstractContextManager[None]] = nullcontext


@dataclass(frozen=True, eq=False)
class ParameterGroup:
    """Numbers of a component's own that the host trains beside the Gaussians.

    Args:
        name: unique within the component.
        tensors: torch leaves that require a gradient; the same ones at every call.
        learning_rate: of Adam (`torch.optim.Adam` with its usual betas and epsilon), >= 0.
    """

    name: str
    tensors: Sequence[Tensor]
    learning_rate: float


class Component(Generic[SettingsType]):
    """Base of all plugins: `class Mine(Regularizer[MySettings])` has settings of type `MySettings`.

    Attributes:
        Settings: the model of the settings, taken from the brackets behind the base class.
        settings: this component's own.
        context: what the host gave it.
        generator: for every random number; seeded from the run's seed and the component's name, and
            saved with checkpoints.
    """

    Settings: ClassVar[type[Settings]] = Settings
    ablation_baseline: ClassVar[str | None] = None
    """What stands in its place where an ablation switches it off, as a pipeline writes a component:
    "name", or "{use: name, ...}". None: nothing does."""
    needs_priors: ClassVar[tuple[str | tuple[str, ...], ...]] = ()
    """Capabilities of the priors that it uses; a tuple among them: any of these, the first preferred.
    Training starts only if the pipeline has them. The setting `prior`, if it exists, names the prior."""
    needs_fields: ClassVar[int] = 1
    """How many fields of Gaussians (`training.fields`) it must be trained with at least."""

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

    def __init__(self, settings: SettingsType, context: Context) -> None:
        import torch

        self.settings = settings
        self.context = context
        self.generator = torch.Generator().manual_seed(context.seed)

    def begin_training(self, scene: TrainingScene) -> None:
        """Look at the scene, before `parameters` is asked and before the first iteration.

        Asked once of each component of the training loop, in a run that is resumed before `restore`.
        """

    def parameters(self) -> Sequence[ParameterGroup]:
        """Numbers of one's own that take part in the loss; the host steps and saves them."""
        return ()

    def state(self) -> dict[str, Tensor]:
        """Running state to be saved in a checkpoint, beside the generator's and the parameters'."""
        return {}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take back what `state` returned."""

    def carry(self, source: Tensor, fresh: Tensor) -> None:
        """Follow a change of topology with per-Gaussian state of one's own.

        Args:
            source: `[N_new]` int64, the old index that each new Gaussian comes from.
            fresh: `[N_new]` bool, True for Gaussians that did not exist before.
        """
