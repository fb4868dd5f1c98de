"""What every plugin is built from: typed settings, a context, and a random generator of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Generic

import pydantic
from typing_extensions import TypeVar

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Device


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
    """

    name: str
    seed: int
    device: Device


class Component(Generic[SettingsType]):
    """Base of all plugins. A subclass may define a nested `Settings` class of its own."""

    Settings: ClassVar[type[Settings]] = Settings

    def __init__(self, settings: SettingsType, context: Context) -> None:
        import torch  # only now: settings are checked without it

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
