"""Peak memory of this process."""

from __future__ import annotations

import mmap
import subprocess
import sys

import torch

from registry.system import memory
from registry.system.memory import available_bytes, memory_added, peak_memory_mb, resident_bytes

BLOCK_MB = 400


def test_it_grows_with_allocations_and_is_not_inherited() -> None:
    before = peak_memory_mb()
    assert before is not None
    block = torch.ones(BLOCK_MB * 1_000_000, dtype=torch.uint8)
    after = peak_memory_mb()
    assert after is not None
    assert after >= BLOCK_MB
    assert int(block[0]) == 1
    # A child that loads nothing is small, however large its parent is.
    code = f"import runpy; print(runpy.run_path({memory.__file__!r})['peak_memory_mb']())"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(child.stdout) < BLOCK_MB / 4


def test_resident_bytes_grow_with_allocated_pages() -> None:
    # New pages from the system; what libraries allocate may be memory that earlier tests gave back.
    size, before = 100_000_000, resident_bytes()
    with mmap.mmap(-1, size) as pages:
        pages.write(bytes([1]) * size)
        assert 0.9 * size < resident_bytes() - before < 2.5 * size
    assert 1e6 < available_bytes() < 1e14


def test_added_memory_is_that_of_the_block() -> None:
    with memory_added() as added, mmap.mmap(-1, 100_000_000) as pages:
        pages.write(bytes([1]) * 100_000_000)
    assert added.megabytes is not None
    assert 90 < added.megabytes < 250
