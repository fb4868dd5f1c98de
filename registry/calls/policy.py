"""What is checked in which call of a component: decided here, and nowhere else.

In every call, errors name the component, the watchdog and the memory ledger record it, writes through torch
into data that it may only read are refused, the state of the process must be left as it was found, and the
answer is checked. `Checks` are the others, which take longer.

    call                          random numbers  every bit  gradient path  repeated
    in the loop: the first        yes             yes        yes            if plugins are checked
                 the second                                                 yes
                 every eleventh   yes                        yes            if plugins are checked
                 others
    initialization                seeded          yes        -              unless it takes long
    scoring: first view, at end   seeded          -          -              unless the metric takes long
    others outside the loop       seeded          yes        -              -

If plugins are checked (`train --check-plugins`), every call has the first three; metrics and the
initializer are always repeated; and components' state must follow each change of topology.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache

SAMPLED_EVERY = 11
"""Calls in the loop between two with longer checks. A prime: if a component does something else in every
n-th call, one of these calls meets it."""
RENDER_GRADIENT_EVERY = 50
"""Iterations between two checks that the render has a gradient."""
QUICK = 0.1
"""Seconds that an initializer may take to be repeated."""
_CHECKED: ContextVar[bool] = ContextVar("checked", default=False)


@dataclass(frozen=True)
class Checks:
    """Checks of one call that take longer than those of every call.

    Args:
        random_numbers: in the loop, it must not use the global random generators.
        every_bit: find writes that bypass torch into data that it may only read, and into the Gaussians.
        gradient_path: a gradient of the answer must reach what is trained.
        repeat_within: repeat the call on a copy, and compare the answers, if it took at most so many
            seconds; None: do not.
    """

    random_numbers: bool = False
    every_bit: bool = False
    gradient_path: bool = False
    repeat_within: float | None = None


def in_loop(number: int) -> Checks:
    """Checks of a call in the training loop; `number` counts the component's calls from 0."""
    return _in_loop(min(number, 2), number % SAMPLED_EVERY == 0, plugins_are_checked())


@cache
def _in_loop(number: int, sampled: bool, checked: bool) -> Checks:
    longer = sampled or checked
    repeated = number == 1 or (sampled and checked)
    return Checks(longer, checked or number == 0, longer, math.inf if repeated else None)


def outside_loop() -> Checks:
    """Checks of a call outside the loop."""
    return Checks(random_numbers=True, every_bit=True)


def within_another() -> Checks:
    """Checks of a call that another component makes, for example to a prior."""
    return Checks(random_numbers=True, every_bit=plugins_are_checked())


def initialization() -> Checks:
    """Checks of the initializer's call."""
    return Checks(True, True, repeat_within=math.inf if plugins_are_checked() else QUICK)


def scoring(*, first: bool, takes_long: bool) -> Checks:
    """Checks of a metric's call.

    Args:
        first: whether it is the first view of the scores after training.
        takes_long: see `ViewMetric.takes_long`.
    """
    repeated = plugins_are_checked() or (first and not takes_long)
    return Checks(True, True, repeat_within=math.inf if repeated else None)


@contextmanager
def checked_plugins(wanted: bool = True) -> Iterator[None]:
    """Within the block, make all checks in each call into a component.

    Each call takes longer by a copy and a comparison of the scene and the Gaussians.
    """
    token = _CHECKED.set(wanted)
    try:
        yield
    finally:
        _CHECKED.reset(token)


def plugins_are_checked() -> bool:
    """Whether this is within `checked_plugins`."""
    return _CHECKED.get()
