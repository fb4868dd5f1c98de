"""Loading large packages."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def collector_at_rest() -> Iterator[None]:
    """Load packages within the block without looking for garbage among what they make.

    torch makes a quarter of a million objects that all stay. To look through them again and again while
    it is loaded takes an eighth of that time. What is there afterwards is never looked through again; where
    the block loads nothing, as for whoever calls twice in one process, nothing is changed.
    """
    at_work, modules = gc.isenabled(), len(sys.modules)
    gc.disable()
    try:
        yield
    finally:
        if len(sys.modules) > modules:
            gc.freeze()
        if at_work:
            gc.enable()
