"""Loading large packages."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def collector_at_rest() -> Iterator[None]:
    """Load packages within the block without looking for garbage among what they make.

    torch makes a million objects that all stay. To look through them again and again, and then through all of
    them whenever there might be garbage, takes an eighth of the time of loading them.
    """
    at_work = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if at_work:
            gc.enable()
