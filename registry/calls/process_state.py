"""What the whole process shares, and a plugin could change under everybody's feet."""

from __future__ import annotations

import ctypes
import logging
import os
import random
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, NamedTuple

from ..errors import PluginError

_MT19937_BYTES = 625 * 4
_TOLD_OF_THREADS: set[str] = set()
_log = logging.getLogger("stereogs")


class Shared(NamedTuple):
    """Something that all of a process share.

    Args:
        name: for messages.
        read: what it is now.
        put_back: make it what it was.
        fix: what to do instead of changing it.
    """

    name: str
    read: Callable[[], Any]
    put_back: Callable[[Any], None]
    fix: str


def _folder() -> str:
    try:
        return os.getcwd()  # noqa: PTH109 - a twentieth of the time of Path.cwd()
    except OSError:  # it was removed
        return ""


_PLACE = Shared(
    "the working directory", _folder, os.chdir, "give paths in full instead of os.chdir"
)


@contextmanager
def left_as_found(who: object, *, threads: bool = True) -> Iterator[None]:
    """Refuse a block that changes what the whole process shares, and put it back.

    The working directory, and torch's gradient mode, default type and number of threads. Of threads
    that the block leaves behind it tells in a warning, once for each `who`.

    Args:
        who: whose text says who is at work.
        threads: whether to tell of threads.

    Raises:
        PluginError: something was changed; names the first.
    """
    shared = _shared()
    before = [one.read() for one in shared]
    number = threading.active_count()
    changed: list[Shared] = []
    try:
        yield
    finally:
        for one, value in zip(shared, before, strict=True):
            if one.read() != value:
                one.put_back(value)
                changed.append(one)
    if threads and threading.active_count() > number and str(who) not in _TOLD_OF_THREADS:
        _TOLD_OF_THREADS.add(str(who))
        newest = threading.enumerate()[number:]
        names = ", ".join(repr(thread.name) for thread in newest)
        _log.warning("%s left a thread behind: %s; join it before you return", who, names)
    if changed:
        raise PluginError(f"it changed {changed[0].name}", fix=changed[0].fix)


@contextmanager
def own_random_numbers(seed: int) -> Iterator[None]:
    """Within the block the global generators of torch, numpy and `random` are the block's own.

    They begin with a seed, so that a network's first weights are the same in every run, and are put
    back afterwards.

    Args:
        seed: in [0, 2^63).
    """
    import numpy as np
    import torch

    generator = torch.default_generator
    before = generator.get_state(), np.random.get_state(), random.getstate()
    generator.manual_seed(seed)
    np.random.seed(seed % 2**32)
    random.seed(seed)
    try:
        yield
    finally:
        generator.set_state(before[0])
        np.random.set_state(before[1])
        random.setstate(before[2])


@contextmanager
def no_global_random_numbers() -> Iterator[None]:
    """Refuse a block that seeds the global generators of torch, numpy or `random`, or draws from them.

    Raises:
        PluginError: names the generator.
    """
    before = _random_states()
    yield
    for name, state in _random_states().items():
        if state != before[name]:
            raise PluginError(
                f"it drew from {name}, or seeded it: no run could be repeated or resumed",
                fix="draw from self.generator; where a library draws, wrap it: "
                "`with torch.random.fork_rng(): torch.manual_seed(self.context.seed)`",
            )


def _random_states() -> dict[str, Any]:
    import torch

    return {
        "torch's global generator": torch.default_generator.get_state().numpy().tobytes(),
        "numpy's global generator": _numpy_state(),
        "Python's global generator": random.getstate(),
    }


def _numpy_state() -> Any:
    import numpy as np

    generator: Any = np.random.get_bit_generator()  # type: ignore[attr-defined]
    if type(generator) is np.random.MT19937:
        # A hundred times as fast as get_state(), which makes numbers of it.
        return ctypes.string_at(generator.ctypes.state_address, _MT19937_BYTES)
    return generator.state


def _shared() -> tuple[Shared, ...]:
    torch = sys.modules.get("torch")
    return (_PLACE,) if torch is None else (_PLACE, *_of_torch(torch))


@cache
def _of_torch(torch: Any) -> tuple[Shared, ...]:
    return (
        Shared(
            "torch's gradient mode",
            torch.is_grad_enabled,
            torch.set_grad_enabled,
            "use `with torch.no_grad():`, which ends by itself",
        ),
        Shared(
            "torch's default type",
            torch.get_default_dtype,
            torch.set_default_dtype,
            "give tensors a dtype where they are made",
        ),
        Shared(
            "torch's number of threads",
            torch.get_num_threads,
            torch.set_num_threads,
            "leave it: sums would depend on it",
        ),
    )
