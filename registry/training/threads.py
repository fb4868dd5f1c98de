"""torch with a single thread, for as long as a run is at work."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Let torch use one thread within the block, or the function that this decorates.

    torch's own threads would wait in a spin beside the OpenCL device's: small operations between
    kernels then cost milliseconds. One thread also makes torch's sums independent of the machine.
    """
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
