"""The search for a driver's name of the processor, on memory of our own."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Iterator
from io import FileIO
from pathlib import Path

import pytest

from core_rasterizer.device.unknown_cpu import better_name, names_reachable_from

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


AVX2 = frozenset(["avx2", "fma", "bmi1", "bmi2", "movbe", "f16c"])
AVX512 = AVX2 | frozenset(
    ["avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "clwb", "adx"]
)


@pytest.mark.parametrize("text", [b"generic\0", b"znver3\0"])
def test_finds_the_string_behind_a_pointer(memory: FileIO, text: bytes) -> None:
    name = ctypes.create_string_buffer(text + b"behind it")
    other = ctypes.create_string_buffer(b"generics are not it")
    address = ctypes.addressof(name)
    handle = structure(ctypes.addressof(other), address)
    assert names_reachable_from(memory, ctypes.addressof(handle)) == [(address, text)]


def test_addresses_that_do_not_exist_are_passed_over(memory: FileIO) -> None:
    handle = structure(0, 1, 0x20000, (1 << 47) - 16, 1 << 63, 0xDEADBEEF000)
    assert names_reachable_from(memory, ctypes.addressof(handle)) == []
    assert names_reachable_from(memory, 0) == []


def test_a_better_name_says_more_and_fits() -> None:
    assert better_name(b"generic\0", AVX512) == b"skx\0"
    assert better_name(b"generic\0", AVX2) == b"haswell\0"
    assert better_name(b"generic\0", frozenset(("sse2",))) is None
    assert better_name(b"znver3\0", AVX512) == b"skx\0"
    assert better_name(b"znver3\0", AVX2) is None
