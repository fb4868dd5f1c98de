"""The components of a running pipeline: built from their items, saved and restored together."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from torch import Tensor

from core_rasterizer import Device, Engine

from ..calls.call import call, calling
from ..calls.policy import Checks, in_loop, outside_loop, plugins_are_checked, within_another
from ..calls.read_only_guard import NOTHING, ReadOnlyGuard
from ..contract.checks.answers import check_carried, check_state
from ..contract.component import Component, Context, no_priors
from ..contract.hook_points import PIPELINE_POINTS
from ..contract.prior import Prior
from ..contract.rendered import Rendered
from ..contract.scene import Scene
from ..discovery import SCENE
from ..errors import RunError
from ..toolkit.progress.stages import progress
from .faults import needs_rendered
from .pipeline import Item, Pipeline
from .settings_check import with_local_copies

TRAINING_SECTIONS = frozenset(p.section for p in PIPELINE_POINTS if p.scheduled and not p.observes)
"""The sections whose components take part in the training loop; each field has its own."""


@dataclass(frozen=True, eq=False)
class Part:
    """A constructed component, and the item of the pipeline that it was built from."""

    item: Item
    component: Any

    @cached_property
    def declared(self) -> frozenset[Rendered]:
        """Outputs that it may use (`Component.needs_rendered`)."""
        return frozenset(needs_rendered(self.item))

    def call(
        self,
        *given: Any,
        iteration: int | None = None,
        checks: Checks | None = None,
        guard: ReadOnlyGuard = NOTHING,
        trained: Sequence[Tensor] = (),
        again: tuple[Any, ...] | None = None,
    ) -> Any:
        """Call the method of the component's hook point, and return its checked answer.

        Args:
            given, guard, trained, again: see `registry.calls.call.call`.
            iteration: of training; None outside the loop.
            checks: besides those of every call; None: as the policy says for this iteration.
        """
        return call(
            *(self.item, self.component, given, checks or self._checks(iteration)),
            iteration=iteration,
            guard=guard,
            trained=trained,
            again=again,
        )

    def at_work(
        self, iteration: int | None = None, guard: ReadOnlyGuard = NOTHING
    ) -> AbstractContextManager[None]:
        """Return a context for calls of the component's other methods; see `registry.calls.call.calling`."""
        seed, checks = self.component.context.seed, self._checks(iteration)
        return calling(self.item, seed, checks, iteration=iteration, guard=guard)

    def _checks(self, iteration: int | None) -> Checks:
        return (
            outside_loop() if iteration is None else in_loop(self.item.schedule.number(iteration))
        )


class Parts:
    """The components of a pipeline; those of a section are constructed on its first use.

    Args:
        pipeline, device: also attributes.
        constructed: parts of the same run; those with equal settings and seed are reused.

    Raises:
        PluginError: the constructor of a component failed; raised on first use.
    """

    def __init__(
        self, pipeline: Pipeline, device: Device | Engine, constructed: Iterable[Part] = ()
    ) -> None:
        self.pipeline, self.device = pipeline, device
        self._constructed = {part.item.qualified_name: part for part in constructed}
        self._parts: dict[str, tuple[Part, ...]] = {}

    def following(self, pipeline: Pipeline) -> Parts:
        """Return the components of another pipeline of the same run; those that do not train are shared."""
        outside = (parts for name, parts in self._parts.items() if name not in TRAINING_SECTIONS)
        return Parts(pipeline, self.device, [part for parts in outside for part in parts])

    def for_field(self, index: int) -> Parts:
        """Return the components of the pipeline for another field of Gaussians.

        Those that train are constructed again, with their own random numbers; the others are shared, except
        observers, which receive the first field only.

        Args:
            index: number of the field. 0 gives a second set for the first field, with equal random numbers.
        """
        seed, other = self.pipeline.training.seed, copy(self)
        other._parts = {point.section: () for point in PIPELINE_POINTS if point.observes}
        for section, items in self.pipeline.items.items():
            if section in TRAINING_SECTIONS:
                parts = [build_part(item, seed, self.device, field=index) for item in items]
                other._parts[section] = tuple(parts)
            else:
                other._parts.setdefault(section, self[section])
        return other

    def __getitem__(self, section: str) -> tuple[Part, ...]:
        if section not in self._parts:
            self._parts[section] = tuple(map(self._part, self.pipeline.items[section]))
        return self._parts[section]

    def _part(self, item: Item) -> Part:
        seed = self.pipeline.training.seed
        known = self._constructed.get(item.qualified_name)
        if (
            known is not None
            and type(known.component) is item.offer.component
            and known.item.settings == item.settings
            and known.component.context.seed == derived_seed(seed, item.qualified_name)
        ):
            return replace(known, item=item)
        if item.point is not SCENE:
            return build_part(item, seed, self.device)
        item = replace(item, settings=with_local_copies(item.settings))
        return build_part(item, seed, self.device, priors=self._priors)

    def _priors(self, base: type[Any]) -> Mapping[str, Prior[Any]]:
        return {part.item.name: part.component for part in self.priors_of(base)}

    def priors_of(self, base: type[Any]) -> list[Part]:
        """Return the priors of a base class; no others are constructed."""
        built = {part.item.name: part for part in self._parts.get("priors", ())}
        items = [i for i in self.pipeline.items["priors"] if issubclass(i.offer.component, base)]
        return [built.get(item.name) or self._part(item) for item in items]

    def __iter__(self) -> Iterator[Part]:
        return (part for section in self.pipeline.items for part in self[section])

    @property
    def training(self) -> Iterator[Part]:
        """Those that are called within the training loop."""
        return (p for name in self.pipeline.items if name in TRAINING_SECTIONS for p in self[name])

    @property
    def shared(self) -> Iterator[Part]:
        """Those that the fields of a run share: all outside the training loop."""
        return (part for part in self if part.item.point.section not in TRAINING_SECTIONS)

    def one(self, section: str) -> Part:
        """The component of a section that holds exactly one."""
        (part,) = self[section]
        return part

    def due(self, section: str, iteration: int) -> Iterator[Part]:
        """Return the components that are called in this iteration, in the pipeline's order."""
        parts = self[section]
        return (p for p in parts if p.item.host.weight > 0 and p.item.host.due(iteration))

    @cached_property
    def priors(self) -> Mapping[str, Prior[Any]]:
        """The priors by name."""
        return {part.item.name: part.component for part in self["priors"]}

    def carry(self, source: Tensor, fresh: Tensor, count: int, iteration: int) -> None:
        """Tell every component that Gaussians were added or removed; see `Component.carry`.

        If plugins are checked, state with one entry per Gaussian, `count` before, must follow.
        """
        for part in self:
            with part.at_work(iteration):
                before = check_state(part.component.state()) if plugins_are_checked() else None
                part.component.carry(source, fresh)
                if before is not None:
                    check_carried(before, part.component.state(), count, len(source))

    def state(self, iteration: int) -> dict[str, Tensor]:
        """Return the running state of all components and of their generators, by slashed names."""
        state: dict[str, Tensor] = {}
        for part in self:
            name = part.item.qualified_name
            state[f"{name}/generator"] = part.component.generator.get_state()
            with part.at_work(iteration):
                own = check_state(part.component.state())
                state |= {f"{name}/state/{key}": value.clone() for key, value in own.items()}
        return state

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned.

        Raises:
            RunError: the checkpoint was written by a pipeline with other components.
        """
        for part in self:
            name = part.item.qualified_name
            if f"{name}/generator" not in state:
                if part.item.point.observes:  # may be added when a run is resumed
                    continue
                raise RunError(
                    f"the checkpoint has no component {name!r}",
                    where=str(part.item.place),
                    fix="resume with the pipeline that the run folder holds, unchanged",
                )
            part.component.generator.set_state(state[f"{name}/generator"])
            prefix = f"{name}/state/"
            own = {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}
            with part.at_work():
                part.component.restore(own)


def build_part(
    item: Item,
    seed: int,
    device: Device | Engine,
    *,
    field: int = 0,
    priors: Callable[[type[Any]], Mapping[str, Any]] = no_priors,
) -> Part:
    """Build one component, with a seed derived from `seed` and its name.

    Args:
        device: the component gets the device of an engine.
        field: number of its field of Gaussians.
        priors: see `Context`.

    Raises:
        PluginError: the constructor failed.
    """
    name = f"{item.qualified_name}/{field}" if field else item.qualified_name
    own_seed = derived_seed(seed, name)
    device = device if isinstance(device, Device) else device.device

    def at_work() -> AbstractContextManager[None]:
        return calling(item, own_seed, within_another())

    context = Context(item.name, own_seed, device, at_work, priors)
    with at_work():
        component: Component[Any] = item.offer.component(item.settings, context)
    return Part(item, component)


def load_scene(loader: Part) -> Scene:
    """Load a scene and validate it; raises an ExplainedError if the loader fails or it is not valid."""
    progress("reading")
    scene: Scene = loader.call()
    return scene


def derived_seed(seed: int, name: str) -> int:
    """Return a seed in [0, 2^63) for a part of a run, the same on every machine.

    With separate seeds, toggling one part does not change another's random numbers.

    Args:
        name: unique within the run, for example "regularizers.stereo_depth".
    """
    digest = hashlib.sha256(f"{seed}:{name}".encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1
