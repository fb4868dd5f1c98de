"""When a component is due, and how many spherical-harmonic bands are in use."""

from __future__ import annotations

import re
from collections.abc import Mapping
from fractions import Fraction
from typing import Annotated, Any, Literal, Self

import pydantic

from ..contract.component import Settings
from ..errors import PipelineError
from .yaml_source import Node

_SHARE = re.compile(r"([0-9]+(?:\.[0-9]+)?)%")


class Schedule(Settings):
    """The iterations in which a component is called.

    Due exactly when start <= iteration <= stop and iteration % every == phase % every. Iterations count
    from 1. A given `start` is the first due iteration: `start: 5, every: 2` is due at 5, 7, 9. Without
    `start`, `every: 100` is due at 100, 200. An explicit `phase` overrides both: `start: 550, every: 100,
    phase: 0` is due at 600, 700. In a pipeline, all four may also be written as a share of
    `training.iterations`, such as `50%`.
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
        return data  # the fields' own types refuse it

    @pydantic.model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.stop is not None and self.stop < self.start:
            raise ValueError(f"stop ({self.stop}) is before start ({self.start})")
        return self

    def due(self, iteration: int) -> bool:
        """Whether the component is called in this iteration."""
        in_turn = (iteration - self.phase) % self.every == 0
        return in_turn and iteration >= self.start and not self.over(iteration)

    def ever_due(self, iterations: int) -> bool:
        """Whether the component is called at all in so many iterations."""
        last = iterations if self.stop is None else min(iterations, self.stop)
        first_turn = range(self.start, min(last, self.start + self.every - 1) + 1)
        return any(self.due(iteration) for iteration in first_turn)

    def over(self, iteration: int) -> bool:
        """Whether neither this iteration nor a later one is due."""
        return self.stop is not None and iteration > self.stop


def moved(moment: int, factor: Fraction) -> int:
    """A moment of a run in one of another length, rounded down.

    The first iteration stays the first, and what is due in each one stays due in each.
    """
    return max(1, int(moment * factor)) if moment > 1 else moment


class HostSettings(Schedule):
    """What the host lends to a component beside the component's own settings."""

    use: str
    """The component's name, as its plugin registered it."""
    name: Annotated[str, pydantic.Field(pattern=r"^[A-Za-z0-9_-]+$")] | None = None
    """What this component is called in the pipeline; `use` unless given."""
    enabled: bool = True
    """False switches the component off, as if it were not written."""
    weight: Annotated[float, pydantic.Field(ge=0, allow_inf_nan=False)] = 1.0
    """Factor of a regularizer's term in the loss."""
    step: Literal["together", "alone"] = "together"
    """A regularizer's term joins the loss, or has a backward pass and an optimizer step of its own,
    before the iteration's own render, in the order of the pipeline."""

    def scaled(self, factor: Fraction) -> Self:
        """The same in a run of another length."""
        changes = {
            "start": moved(self.start, factor),
            "stop": None if self.stop is None else moved(self.stop, factor),
            "every": moved(self.every, factor),
            "phase": int(self.phase * factor),
        }
        return self.model_validate({**self.model_dump(), **changes})


def in_iterations(settings: Mapping[str, Node], iterations: int) -> dict[str, Node]:
    """The host's settings with shares such as `stop: 50%` as numbers of iterations, rounded down.

    In a run so short that a share ends before the start, the component is never due: it is disabled.

    Raises:
        PipelineError: a share is more than 100 %.
    """
    result = dict(settings)
    shares: list[Node] = []
    for name in ("start", "stop", "every", "phase"):
        node = settings.get(name)
        share = _SHARE.fullmatch(node.content) if node and isinstance(node.content, str) else None
        if node and share:
            if float(share[1]) > 100:
                raise PipelineError(
                    f"{name} is {node.content} of the iterations: that moment never comes",
                    where=str(node.place),
                    fix="write a share from 0% to 100%, or a number of iterations",
                )
            moment = int(Fraction(share[1]) * iterations / 100)  # floats make 57 % of 10,000 5,699
            result[name] = Node(max(1, moment), node.place)
            shares.append(result[name])
    start, stop = (result[name].content if name in result else None for name in ("start", "stop"))
    if shares and isinstance(start, int) and isinstance(stop, int) and stop < start:
        del result["start"], result["stop"]
        result["enabled"] = Node(False, shares[0].place)
    return result


def active_sh_degree(iteration: int, sh_degree: int, every: int) -> int:
    """Bands in use: degree 0 at first, one more in each multiple of `every` (3DGS: 1000).

    Args:
        iteration: 1-based.
        sh_degree: the highest degree, 0 to 3.
        every: iterations between two bands, >= 1.
    """
    return min(sh_degree, iteration // every)
