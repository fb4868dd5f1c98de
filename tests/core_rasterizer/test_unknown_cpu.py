"""The search for a driver's name of the processor, on memory of our own."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Iterator
from io import FileIO
from pathlib import Path

import pytest

from core_rasterizer.unknown_cpu import strings_reachable_from

MEMORY = Path("/proc/self/mem")
pytestmark = pytest.mark.skipif(not MEMORY.exists(), reason="the system has no /proc/self/mem")


@pytest.fixture
def memory() -> Iterator[FileIO]:
    with FileIO(MEMORY, "rb") as file:
        yield file


def structure(*pointers: int) -> ctypes.Array[ctypes.c_char]:
    """A driver's structure: 4096 bytes, the pointers somewhere in the middle."""
    block = ctypes.create_string_buffer(4096)
    struct.pack_into(f"<{len(pointers)}Q", block, 640, *pointers)
    return block


def test_finds_the_string_behind_a_pointer(memory: FileIO) -> None:
    name = ctypes.create_string_buffer(b"generic")
    other = ctypes.create_string_buffer(b"generics are not it")
    address = ctypes.addressof(name)
    handle = structure(ctypes.addressof(other), address)
    assert strings_reachable_from(memory, ctypes.addressof(handle)) == [address]


def test_addresses_that_do_not_exist_are_passed_over(memory: FileIO) -> None:
    handle = structure(0, 1, 0x20000, (1 << 47) - 16, 1 << 63, 0xDEADBEEF000)
    assert strings_reachable_from(memory, ctypes.addressof(handle)) == []
    assert strings_reachable_from(memory, 0) == []
