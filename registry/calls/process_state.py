"""State that the whole process shares: plugins must not change it."""

from __future__ import annotations

import ctypes
import logging
import os
import random
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from importlib import import_module
from typing import Any, NamedTuple

from ..errors import PluginError

_MT19937_BYTES = 625 * 4
_WARNED_OF_THREADS: set[str] = set()
_log = logging.getLogger("stereogs")


def _folder() -> str:
    try:
        return os.getcwd()  # noqa: PTH109 - a twentieth of the time of Path.cwd()
    except OSError:  # it was removed
        return ""


_TORCH = {
    "gradient mode": ("is_grad_enabled", "set_grad_enabled", "use `with torch.no_grad():`"),
    "default type": (
        "get_default_dtype",
        "set_default_dtype",
        "give tensors a dtype where they are made",
    ),
    "number of threads": ("get_num_threads", "set_num_threads", "leave it: sums depend on it"),
}
"""Functions that read and write torch's state, and what to do instead of changing it."""


class _Shared(NamedTuple):
    """A part of the process's state; `fix` says what to do instead of changing it."""

    name: str
    read: Callable[[], Any]
    write: Callable[[Any], None]
    fix: str


@cache
def _shared(with_torch: bool) -> tuple[_Shared, ...]:
    """Return the parts of the process's state; `with_torch`: torch is imported."""
    fix = "give paths in full instead of os.chdir"
    parts = [_Shared("the working directory", _folder, os.chdir, fix)]
    if with_torch:
        torch = sys.modules["torch"]
        for name, (read, write, fix) in _TORCH.items():
            read, write = getattr(torch, read), getattr(torch, write)
            parts.append(_Shared(f"torch's {name}", read, write, fix))
        # Read from there in a hundredth of the time of torch.get_default_device().
        device = partial(getattr, import_module("torch.utils._device"), "CURRENT_DEVICE")
        fix = "give tensors a device where they are made"
        parts.append(_Shared("torch's default device", device, torch.set_default_device, fix))
    return tuple(parts)


class left_as_found:
    """A context that restores the process's state after the block, and refuses a block that changed it.

    The state is the working directory, and torch's default device, gradient mode, default type and number
    of threads.

    Args:
        who: its text names the plugin.
        threads: whether to warn, once for each `who`, about threads that the block leaves running.

    Raises:
        PluginError: a part was changed; names the first.
    """

    __slots__ = ("_before", "_count", "_shared", "_threads", "_who")

    def __init__(self, who: object, *, threads: bool = True) -> None:
        self._who, self._threads = who, threads

    def __enter__(self) -> None:
        self._shared = _shared("torch" in sys.modules)
        self._before = [part.read() for part in self._shared]
        self._count = threading.active_count()

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        changed = []
        for value, part in zip(self._before, self._shared, strict=True):
            if part.read() != value:
                part.write(value)
                changed.append(part)
        if error is not None:
            return
        if self._threads and threading.active_count() > self._count:
            _warn_of_threads(str(self._who), self._count)
        if changed:
            raise PluginError(f"it changed {changed[0].name}", fix=changed[0].fix)


def _warn_of_threads(who: str, count: int) -> None:
    """Warn of threads that are running besides the first `count`, once for each `who`."""
    if who not in _WARNED_OF_THREADS:
        _WARNED_OF_THREADS.add(who)
        names = ", ".join(repr(thread.name) for thread in threading.enumerate()[count:])
        _log.warning("%s left a thread running: %s; join it before you return", who, names)


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Limit torch to one thread within the block, or in the function that this decorates.

    torch's threads spin while they wait and compete with those of the OpenCL device: small operations between
    kernels then take milliseconds. One thread also makes torch's sums independent of the machine.
    """
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def own_random_numbers(seed: int) -> Iterator[None]:
    """Seed the global generators of torch, numpy and `random` for the block; restore them afterwards.

    So a network's initial weights are the same in every run.

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
    """Refuse a block that uses or seeds the global generators of torch, numpy or `random`.

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
    import numpy as np
    import torch

    generator: Any = np.random.get_bit_generator()  # type: ignore[attr-defined]
    if type(generator) is np.random.MT19937:
        # A hundred times as fast as get_state(), which converts to numbers.
        numpy = ctypes.string_at(generator.ctypes.state_address, _MT19937_BYTES)
    else:
        numpy = generator.state
    return {
        "torch's global generator": torch.default_generator.get_state().numpy().tobytes(),
        "numpy's global generator": numpy,
        "Python's global generator": random.getstate(),
    }
