"""A single torch thread while a run computes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


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
