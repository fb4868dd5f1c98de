"""Call a function in processes that differ as those of two runs do: in process number and hash seed."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from typing import Any
from unittest import mock

SEEDS: tuple[str, ...] = ("1", "2")
"""Values of PYTHONHASHSEED, of one process each; they serve all later calls."""


def in_other_processes(function: Callable[..., Any], *given: Any) -> list[Any]:
    """Return the result in each process; empty if the arguments cannot be pickled, or the call fails there.

    Classes that a test defines within a function cannot be pickled.
    """
    try:
        pickle.dumps(given)
        return [_process(*one).submit(function, *given).result() for one in enumerate(SEEDS)]
    except Exception:
        return []


@cache
def _process(number: int, seed: str) -> ProcessPoolExecutor:
    pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"))
    with mock.patch.dict(os.environ, PYTHONHASHSEED=seed):
        pool.submit(os.getpid).result()
    return pool
