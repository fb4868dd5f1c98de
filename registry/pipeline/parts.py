"""The components of a running pipeline: built from their items, saved and restored together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from ..calls.read_only_guard import NOTHING, ReadOnlyGuard, are_checked
from ..contract.component import Component, Context
from ..contract.hook_points import PIPELINE_POINTS
from ..contract.prior import Prior
from ..errors import RunError
from .blame import at_work
from .pipeline import Item, Pipeline
from .seeding import derived_seed

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Device

TRAINING_SECTIONS = frozenset(p.section for p in PIPELINE_POINTS if p.scheduled and not p.observes)
"""The sections whose components take part in the training loop, those of each field in its own."""

LOOK_EVERY = 10
"""Iterations between two looks at the global random generators."""


@dataclass(frozen=True, eq=False)
class Part:
    """A component at work, and the item of the pipeline that it was built from."""

    item: Item
    component: Any
    """Of the class that the item's hook point names."""

    def at_work(
        self, iteration: int | None = None, lent: ReadOnlyGuard = NOTHING
    ) -> AbstractContextManager[None]:
        """A block in which the component is called; see `registry.pipeline.blame.at_work`.

        Whether it touches global random generators is looked at in its first call of the loop and in
        every tenth iteration; in each if plugins are checked.
        """
        schedule = self.item.schedule
        number = iteration or 0
        first = number < schedule.start + schedule.every
        look = first or number % LOOK_EVERY == 0 or are_checked()
        return at_work(self.item, self.component.context.seed, iteration, lent, look=look)


class Parts:
    """Every component of a pipeline, each with a random generator of its own.

    Components of a section are constructed when the section is first used.

    Args:
        constructed: parts of the same run; those with equal settings and seed are used again.

    Raises:
        PluginError: the constructor of a component failed; raised on first use.
    """

    def __init__(
        self, pipeline: Pipeline, device: Device, constructed: Iterable[Part] = ()
    ) -> None:
        self._pipeline, self._device = pipeline, device
        self._constructed = {part.item.qualified_name: part for part in constructed}
        self._parts: dict[str, tuple[Part, ...]] = {}

    def following(self, pipeline: Pipeline) -> Parts:
        """The components of another pipeline of the same run, shared where settings and seed are equal."""
        return Parts(pipeline, self._device, [p for parts in self._parts.values() for p in parts])

    def for_field(self, index: int) -> Parts:
        """The components of the pipeline for another field of Gaussians.

        Those that train are constructed again, with their own random numbers; the others are shared, except
        observers, which receive the first field only.

        Args:
            index: number of the field. 0 gives a second set for the first field, with equal random numbers.
        """
        other = copy(self)
        other._parts = {
            section: tuple(
                build_part(item, self._pipeline.training.seed, self._device, field=index)
                for item in items
            )
            if section in TRAINING_SECTIONS
            else self[section]
            for section, items in self._pipeline.items.items()
        }
        other._parts |= {point.section: () for point in PIPELINE_POINTS if point.observes}
        return other

    def __getitem__(self, section: str) -> tuple[Part, ...]:
        if section not in self._parts:
            self._parts[section] = tuple(map(self._part, self._pipeline.items[section]))
        return self._parts[section]

    def _part(self, item: Item) -> Part:
        seed = self._pipeline.training.seed
        known = self._constructed.get(item.qualified_name)
        if (
            known is not None
            and type(known.component) is item.offer.component
            and known.item.settings == item.settings
            and known.component.context.seed == derived_seed(seed, item.qualified_name)
        ):
            return replace(known, item=item)
        return build_part(item, seed, self._device)

    def __iter__(self) -> Iterator[Part]:
        return (part for section in self._pipeline.items for part in self[section])

    @property
    def training(self) -> Iterator[Part]:
        """Those that are asked within the training loop."""
        sections = (name for name in self._pipeline.items if name in TRAINING_SECTIONS)
        return (part for section in sections for part in self[section])

    @property
    def shared(self) -> Iterator[Part]:
        """Those that the fields of a run share: all that do not train."""
        return (part for part in self if part.item.point.section not in TRAINING_SECTIONS)

    def one(self, section: str) -> Part:
        """The component of a section that holds exactly one."""
        (part,) = self[section]
        return part

    def due(self, section: str, iteration: int) -> Iterator[Part]:
        """Those that are called in this iteration, in the pipeline's order."""
        return (
            part
            for part in self[section]
            if part.item.schedule.due(iteration) and part.item.host.weight > 0
        )

    @property
    def priors(self) -> Mapping[str, Prior[Any]]:
        """The prior models by name."""
        return {part.item.name: part.component for part in self["priors"]}

    def carry(self, source: Tensor, fresh: Tensor, count: int, iteration: int) -> None:
        """Tell every component that Gaussians came or went; see `Component.carry`.

        Where plugins are checked, state of as many entries as there were Gaussians must follow.

        Args:
            count: how many there were.
        """
        from ..contract.checks.answers import check_carried, check_state

        for part in self:
            with part.at_work(iteration):
                before = check_state(part.component.state()) if are_checked() else None
                part.component.carry(source, fresh)
                if before is not None:
                    check_carried(before, part.component.state(), count, len(source))

    def state(self, iteration: int) -> dict[str, Tensor]:
        """The running state of all components, and of their generators, by slashed names."""
        from ..contract.checks.answers import check_state

        state: dict[str, Tensor] = {}
        for part in self:
            name = part.item.qualified_name
            state[f"{name}/generator"] = part.component.generator.get_state()
            with part.at_work(iteration):
                own = check_state(part.component.state())
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
                if part.item.point.observes:  # new in a run that goes on
                    continue
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
            with part.at_work():
                part.component.restore(own)


def build_part(item: Item, seed: int, device: Device, *, field: int = 0) -> Part:
    """Build one component, with a seed derived from `seed` and its name.

    Args:
        field: number of the field of Gaussians that it works for.

    Raises:
        PluginError: it failed while it was built.
    """
    name = f"{item.qualified_name}/{field}" if field else item.qualified_name
    own_seed = derived_seed(seed, name)
    context = Context(item.name, own_seed, device, partial(at_work, item, own_seed))
    with context.at_work():
        component: Component[Any] = item.offer.component(item.settings, context)
    return Part(item, component)
