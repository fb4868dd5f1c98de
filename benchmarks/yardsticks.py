"""What a machine takes for plain work on as many bytes, so that times of different machines compare."""

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
    """Milliseconds with all cores at work, for the parameters of so many Gaussians.

    Args:
        copy: reading them all and writing them elsewhere.
        adam: one step of torch's fused Adam.
    """

    copy: float
    adam: float

    def ratios(self, time_ms: float) -> tuple[str, str]:
        """A time in copies and in steps of Adam, as a table's cells."""
        return f"{time_ms / self.copy:.1f}", f"{time_ms / self.adam:.2f}"


def yardsticks(count: int) -> Yardsticks:
    """Measured for `count` Gaussians."""
    parameters = torch.randn(ROWS, count, requires_grad=True)
    parameters.grad = torch.randn(ROWS, count)
    source, elsewhere = parameters.detach(), torch.empty(ROWS, count)
    adam = torch.optim.Adam([parameters], lr=1e-6, eps=1e-15, fused=True)
    with all_torch_threads():
        return Yardsticks(
            copy=milliseconds(lambda: elsewhere.copy_(source)), adam=milliseconds(adam.step)
        )


def milliseconds(work: Callable[[], Any], repeats: int = 45) -> float:
    """Median of several runs after two that are not counted."""
    times = []
    for _ in range(repeats + 2):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return 1e3 * median(times[2:])


@contextmanager
def all_torch_threads() -> Iterator[None]:
    """Give torch every core, as a baseline has it; beside the engine it runs with one."""
    before = torch.get_num_threads()
    torch.set_num_threads(os.cpu_count() or 1)
    yield
    torch.set_num_threads(before)
