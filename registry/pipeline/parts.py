"""The components of a running pipeline: built from their items, saved and restored together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..contract.component import Component, Context
from ..contract.prior import Prior
from ..errors import RunError
from .blame import blame
from .pipeline import Item, Pipeline
from .seeding import derived_seed

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Device


@dataclass(frozen=True, eq=False)
class Part:
    """A component at work, and the item of the pipeline that it was built from."""

    item: Item
    component: Any
    """Of the class that the item's hook point names."""


class Parts:
    """Every component of a pipeline, each with a random generator of its own.

    Raises:
        PluginError: a component failed while it was built.
    """

    def __init__(self, pipeline: Pipeline, device: Device) -> None:
        self._parts = {
            section: tuple(build_part(item, pipeline.training.seed, device) for item in items)
            for section, items in pipeline.items.items()
        }

    def __getitem__(self, section: str) -> tuple[Part, ...]:
        return self._parts[section]

    def __iter__(self) -> Iterator[Part]:
        return (part for parts in self._parts.values() for part in parts)

    def one(self, section: str) -> Part:
        """The component of a section that holds exactly one."""
        (part,) = self._parts[section]
        return part

    def due(self, section: str, iteration: int) -> Iterator[Part]:
        """Those that are called in this iteration, in the pipeline's order."""
        return (
            part
            for part in self._parts[section]
            if part.item.schedule.due(iteration) and part.item.host.weight > 0
        )

    @property
    def priors(self) -> Mapping[str, Prior[Any]]:
        """The prior models by name."""
        return {part.item.name: part.component for part in self._parts["priors"]}

    def carry(self, source: Tensor, fresh: Tensor, iteration: int) -> None:
        """Tell every component that Gaussians came or went; see `Component.carry`."""
        for part in self:
            with blame(part.item, iteration):
                part.component.carry(source, fresh)

    def state(self, iteration: int) -> dict[str, Tensor]:
        """The running state of all components, and of their generators, by slashed names."""
        state: dict[str, Tensor] = {}
        for part in self:
            name = part.item.qualified_name
            state[f"{name}/generator"] = part.component.generator.get_state()
            with blame(part.item, iteration):
                own: Mapping[str, Tensor] = part.component.state()
                state |= {f"{name}/state/{key}": value.clone() for key, value in own.items()}
        return state

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take back what `state` returned.

        Raises:
            RunError: the checkpoint was written by a pipeline with other components.
        """
        for part in self:
            start = f"{part.item.qualified_name}/"
            if f"{start}generator" not in state:
                raise RunError(
                    f"the checkpoint knows no component {part.item.qualified_name!r}",
                    where=str(part.item.place),
                    fix="resume with the pipeline that the run folder holds, unchanged",
                )
            part.component.generator.set_state(state[f"{start}generator"])
            own = {
                key.removeprefix(f"{start}state/"): value
                for key, value in state.items()
                if key.startswith(f"{start}state/")
            }
            with blame(part.item):
                part.component.restore(own)


def build_part(item: Item, seed: int, device: Device) -> Part:
    """Build one component, with a seed derived from `seed` and its name.

    Raises:
        PluginError: it failed while it was built.
    """
    context = Context(item.name, derived_seed(seed, item.qualified_name), device)
    with blame(item):
        component: Component[Any] = item.offer.component(item.settings, context)
    return Part(item, component)
