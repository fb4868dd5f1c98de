"""Times of plain work on the same number of bytes, to compare times of different machines."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median
from typing import Any

import torch

ROWS = 59
"""Floats of a Gaussian of SH degree 3."""


@dataclass(frozen=True)
class Yardsticks:
    """Milliseconds on all cores, for the parameters of a number of Gaussians.

    Args:
        copy: A copy of the parameters.
        adam: One step of torch's fused Adam.
    """

    copy: float
    adam: float

    def ratios(self, time_ms: float) -> tuple[str, str]:
        """Return a time in copies and in steps of Adam, as cells of a table."""
        return f"{time_ms / self.copy:.1f}", f"{time_ms / self.adam:.2f}"


def yardsticks(count: int) -> Yardsticks:
    """Measure for `count` Gaussians."""
    parameters = torch.randn(ROWS, count, requires_grad=True)
    parameters.grad = torch.randn(ROWS, count)
    source, elsewhere = parameters.detach(), torch.empty(ROWS, count)
    adam = torch.optim.Adam([parameters], lr=1e-6, eps=1e-15, fused=True)
    with all_torch_threads():
        return Yardsticks(
            copy=milliseconds(lambda: elsewhere.copy_(source)), adam=milliseconds(adam.step)
        )


def milliseconds(work: Callable[[], Any], repeats: int = 45) -> float:
    """Return the median of several runs after two warm-up runs."""
    times = []
    for _ in range(repeats + 2):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return 1e3 * median(times[2:])


def python_milliseconds(repeats: int = 300) -> float:
    """Return CPU milliseconds of a fixed loop of pure Python on this thread, the least of several runs."""

    def loop() -> float:
        begin, counts = time.thread_time(), dict[int, int]()
        for number in range(10_000):
            key = number * number % 97
            counts[key] = counts.get(key, 0) + 1
        return time.thread_time() - begin

    return 1e3 * min(loop() for _ in range(repeats))


@contextmanager
def all_torch_threads() -> Iterator[None]:
    """Let torch use every core, for baselines; next to the engine it uses one."""
    before = torch.get_num_threads()
    torch.set_num_threads(os.cpu_count() or 1)
    yield
    torch.set_num_threads(before)
