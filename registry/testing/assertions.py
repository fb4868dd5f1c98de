"""Assertions about results, and about side effects of a component."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from ..calls.process_state import left_as_found, no_global_random_numbers, own_random_numbers
from ..calls.repeats import digests
from ..calls.watchdog import WATCHDOG

_SEED = 0x5EED
"""No component is likely to seed a generator with this number; if one did, it would not be noticed."""


def require(holds: bool, message: str) -> None:
    """Raise an AssertionError with the message unless the condition holds.

    Unlike `assert`, it works under `python -O`.
    """
    if not holds:
        raise AssertionError(message)


@contextmanager
def no_side_effects(given: Mapping[str, Any]) -> Iterator[None]:
    """Check that a block changes neither its arguments nor state that the process shares.

    It may add files to a folder. It must not draw from global random generators.

    Args:
        given: the arguments by name.

    Raises:
        AssertionError: an argument was changed; names the part, for example "scene.train[0].image".
        PluginError: shared state was changed; it is restored.
    """
    before = digests(given)
    with (
        WATCHDOG.watching("the component"),  # starts the host's thread before threads are counted
        own_random_numbers(_SEED),
        left_as_found("the component"),
        no_global_random_numbers(),
    ):
        yield
    after = digests(given)
    changed = [name for name, digest in before.items() if after.get(name) != digest]
    require(not changed, f"it changed what it was given: {', '.join(changed[:3])}")
