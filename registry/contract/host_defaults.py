"""Defaults that a component declares for the settings that the host reads."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

LossStep = Literal["together", "alone"]
"""Whether a regularizer's term joins the loss, or has its own backward pass and optimizer step."""


@dataclass(frozen=True)
class Percent:
    """A share of a run's iterations, as a pipeline writes it: `Percent(66.67)` is "66.67%".

    Args:
        value: from 0 to 100.
    """

    value: float

    def __str__(self) -> str:
        return f"{self.value}%"


@dataclass(frozen=True, kw_only=True)
class HostDefaults:
    """A component's defaults of the host's settings, usually its published schedule and weight.

    A pipeline may change each. None leaves the host's own default.

    Args:
        start, stop, every, phase: the schedule, each in iterations or as a share of the run.
        weight: factor of a regularizer's term in the loss, >= 0.
        step: "alone" gives a regularizer's term its own optimizer step.
    """

    start: int | Percent | None = None
    stop: int | Percent | None = None
    every: int | Percent | None = None
    phase: int | Percent | None = None
    weight: float | None = None
    step: LossStep | None = None

    def written(self) -> dict[str, int | float | str]:
        """Return the given values as a pipeline writes them; shares as text."""
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        return {
            name: str(value) if isinstance(value, Percent) else value
            for name, value in given.items()
            if value is not None
        }

    def __str__(self) -> str:
        """For example "start: 2%, every: 100"; empty without values."""
        return ", ".join(f"{name}: {value}" for name, value in self.written().items())
