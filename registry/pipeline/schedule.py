"""The iterations in which a component is called, and the other settings that the host reads."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from fractions import Fraction
from typing import Annotated, Any, Self

import pydantic

from ..contract.component import Settings
from ..contract.host_defaults import LossStep
from .yaml_source import Node

_SHARE = re.compile(r"([0-9]+(?:\.[0-9]+)?)%")


class Schedule(Settings):
    """The iterations in which a component is called.

    Due if start <= iteration <= stop and iteration % every == phase % every. Iterations count from 1. A
    given `start` is the first due iteration: `start: 5, every: 2` is due at 5, 7, 9. Without `start`,
    `every: 100` is due at 100, 200. An explicit `phase` overrides both: `start: 550, every: 100, phase: 0`
    is due at 600, 700. In a pipeline, all four may also be a share of `training.iterations`, such as `50%`.
    """

    start: Annotated[int, pydantic.Field(ge=1)] = 1
    """First iteration that may be due."""
    stop: Annotated[int, pydantic.Field(ge=1)] | None = None
    """Last iteration that may be due; null means the end of training."""
    every: Annotated[int, pydantic.Field(ge=1)] = 1
    """Iterations between two calls."""
    phase: Annotated[int, pydantic.Field(ge=0)] = 0
    """Due when `iteration % every == phase`; unless given, `start % every` if `start` is given."""

    @pydantic.model_validator(mode="before")
    @classmethod
    def _begin_at_start(cls, data: Any) -> Any:
        if not isinstance(data, dict) or "phase" in data:
            return data
        start, every = data.get("start"), data.get("every", 1)
        if isinstance(start, int) and isinstance(every, int) and start > 0 and every > 0:
            return {**data, "phase": start % every}
        return data  # invalid types are reported by the fields

    @pydantic.model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.stop is not None and self.stop < self.start:
            raise ValueError(f"stop ({self.stop}) is before start ({self.start})")
        return self

    def due(self, iteration: int) -> bool:
        """Return whether the component is called in this iteration."""
        in_turn = (iteration - self.phase) % self.every == 0
        return in_turn and iteration >= self.start and not self.over(iteration)

    def due_in(self, iterations: int) -> range:
        """Return the iterations of a run in which the component is called."""
        first = self.start + (self.phase - self.start) % self.every
        last = iterations if self.stop is None else min(iterations, self.stop)
        return range(first, last + 1, self.every)

    def number(self, iteration: int) -> int:
        """Return how many calls come before that of an iteration: 0 for the first, or before it."""
        return max(0, iteration - self.start) // self.every

    def over(self, iteration: int) -> bool:
        """Return whether neither this iteration nor a later one is due."""
        return self.stop is not None and iteration > self.stop


def rescaled(iterations: int, factor: Fraction) -> int:
    """Return iterations in a run of another length, rounded down; 0 and 1 stay as they are."""
    return max(1, int(iterations * factor)) if iterations > 1 else iterations


class HostSettings(Schedule):
    """The settings of a component that the host reads."""

    use: str
    """The component's name, as its plugin registers it."""
    name: Annotated[str, pydantic.Field(pattern=r"^[A-Za-z0-9_-]+$")] | None = None
    """The component's name in the pipeline; `use` unless given."""
    enabled: bool = True
    """False disables the component, as if it were not written."""
    weight: Annotated[float, pydantic.Field(ge=0, allow_inf_nan=False)] = 1.0
    """Factor of a regularizer's term in the loss."""
    step: LossStep = "together"
    """"together": the regularizer's term is added to the loss. "alone": it has its own backward pass and
    optimizer step, before the iteration's render, in the order of the pipeline."""

    def scaled(self, factor: Fraction) -> Self:
        """Return the settings for a run of another length."""
        changes = {
            "start": rescaled(self.start, factor),
            "stop": None if self.stop is None else rescaled(self.stop, factor),
            "every": rescaled(self.every, factor),
            "phase": int(self.phase * factor),
        }
        return self.model_validate({**self.model_dump(), **changes})


def in_iterations(settings: Mapping[str, Node], iterations: int) -> dict[str, Node]:
    """Return the host's settings with shares such as `stop: 50%` as iterations, rounded down.

    If a run is so short that a share ends before the start, the component is never due in it.

    Raises:
        PipelineError: a share is more than 100 %, 0 % where that is no iteration, or ends before it starts
            in a run of any length.
    """
    result = dict(settings)
    shares: dict[str, Fraction] = {}
    for name in Schedule.model_fields:
        node = settings.get(name)
        share = _SHARE.fullmatch(str(node.content)) if node else None
        if node is None or share is None:
            continue
        if float(share[1]) > 100:
            raise node.place.error(
                f"{name} is {node.content} of the iterations, more than there are",
                fix="write a share from 0% to 100%, or a number of iterations",
            )
        shares[name] = Fraction(share[1])
        if not shares[name] and name in ("stop", "every"):
            raise node.place.error(
                f"{name} is 0% of the iterations",
                fix="write a larger share, or `enabled: false` to switch the component off",
            )
        exact = shares[name] * iterations / 100  # with floats, 57 % of 10,000 is 5,699
        result[name] = Node(max(0 if name == "phase" else 1, int(exact)), node.place)
    if {"start", "stop"} <= shares.keys() and shares["stop"] < shares["start"]:
        raise settings["stop"].place.error(
            f"stop ({settings['stop'].content}) is before start ({settings['start'].content})",
            fix="exchange them",
        )
    start, stop = (result[name].content if name in result else None for name in ("start", "stop"))
    if shares and isinstance(start, int) and isinstance(stop, int) and stop < start:
        # Far enough behind the end that it stays there when `scaled` rounds.
        result["start"] = Node(2 * iterations, result["start"].place)
        del result["stop"]
    return result


def with_defaults(written: Mapping[str, Node], defaults: Mapping[str, Node]) -> dict[str, Node]:
    """Return the host's settings, completed by the defaults of a component; both valid and in iterations.

    A written `start` is the first due iteration, whatever the default `phase`. A default `start` or `stop`
    does not apply if it contradicts a written one.
    """
    both = {**defaults, **written}
    numbers = {name: n.content for name, n in both.items() if isinstance(n.content, int)}
    unused = {"phase"} if "start" in written else set()
    if numbers.get("start", 1) > numbers.get("stop", math.inf):
        unused |= {"start", "stop"}
    return {**{name: n for name, n in defaults.items() if name not in unused}, **written}


def active_sh_degree(iteration: int, sh_degree: int, every: int, first: int = 0) -> int:
    """Return the highest band in use: 0 or `first`, and one more in each multiple of `every` (3DGS: 1000).

    Args:
        iteration: 1-based.
        sh_degree: the highest degree, 0 to 3.
        every: iterations between two bands, >= 1.
        first: highest band of the initial Gaussians.
    """
    return min(sh_degree, max(first, iteration // every))
