"""The search for the driver's processor name, in test memory."""

from __future__ import annotations

import ctypes
import os
import struct
import subprocess
import sys
from collections.abc import Iterator
from io import FileIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from core_rasterizer.device import unknown_cpu
from core_rasterizer.device.unknown_cpu import (
    better_cpu_name,
    better_name,
    correct_cpu_name,
    names_reachable_from,
    written_cpu_name,
)

MEMORY = Path("/proc/self/mem")
pytestmark = pytest.mark.skipif(not MEMORY.exists(), reason="the system has no /proc/self/mem")


@pytest.fixture
def memory() -> Iterator[FileIO]:
    with FileIO(MEMORY, "rb") as file:
        yield file


def structure(*pointers: int) -> ctypes.Array[ctypes.c_char]:
    """A driver's structure: 4096 bytes with pointers in the middle."""
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


def test_invalid_addresses_are_skipped(memory: FileIO) -> None:
    handle = structure(0, 1, 0x20000, (1 << 47) - 16, 1 << 63, 0xDEADBEEF000)
    assert names_reachable_from(memory, ctypes.addressof(handle)) == []
    assert names_reachable_from(memory, 0) == []


def test_a_better_name_fits() -> None:
    assert better_name(b"generic\0", AVX512) == b"skx\0"
    assert better_name(b"generic\0", AVX2) == b"haswell\0"
    assert better_name(b"generic\0", frozenset(("sse2",))) is None
    assert better_name(b"znver3\0", AVX512) == b"skx\0"
    assert better_name(b"znver3\0", AVX2) is None


UNKNOWN_PROCESSOR = """
from io import FileIO
from core_rasterizer import list_devices
from core_rasterizer.device import unknown_cpu
from core_rasterizer.self_test import self_test

device = list_devices()[0]
flags = unknown_cpu._processor_flags()
with FileIO("/proc/self/mem", "r+b") as memory:
    found = unknown_cpu.names_reachable_from(memory, device._handle.int_ptr)
    if len(found) != 1 or unknown_cpu.better_name(b"generic\\0", flags) is None:
        print("elsewhere")
        raise SystemExit
    before = found[0][1]
    if not {name!r} and before == b"generic\\0":
        print("elsewhere")  # this processor's own name does not build
        raise SystemExit
    memory.seek(found[0][0])
    memory.write({name!r} or before)
    print(device.built_for, self_test(device).passed)
    memory.seek(found[0][0])
    print(memory.read(16).split(b"\\0")[0] + b"\\0" == before)
"""


def outcome_for_a_processor_named(name: bytes, **environment: str) -> list[str]:
    """Whether a new process computes correctly, and whether it kept the driver's name."""
    result = subprocess.run(
        [sys.executable, "-c", UNKNOWN_PROCESSOR.format(name=name)],
        env={**os.environ, "STEREOGS_CORRECT_CPU_NAME": "", **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    answers = result.stdout.split()
    if answers == ["elsewhere"]:
        pytest.skip("the driver keeps no name here, or none that builds")
    return answers


@pytest.mark.proof
def test_a_name_that_does_not_build_is_replaced(tmp_path: Path) -> None:
    quick = {"POCL_CACHE_DIR": str(tmp_path), "PYOPENCL_BUILD_OPTIONS": "-cl-opt-disable"}
    answers = outcome_for_a_processor_named(b"generic\0", **quick)
    known = better_name(b"generic\0", unknown_cpu._processor_flags())
    assert known is not None  # or the test would have been skipped
    assert answers == [known[:-1].decode(), "True", "False"]


@pytest.mark.proof
def test_a_name_that_builds_is_left_alone() -> None:
    assert outcome_for_a_processor_named(b"") == ["None", "True", "True"]


def test_a_name_that_builds_is_replaced_only_on_request(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(unknown_cpu, "_processor_flags", lambda: AVX512)
    name = ctypes.create_string_buffer(b"znver3\0")
    handle = structure(ctypes.addressof(name))
    platform = SimpleNamespace(name="Portable Computing Language")
    device: Any = SimpleNamespace(platform=platform, int_ptr=ctypes.addressof(handle))
    assert better_cpu_name(device) == "skx"
    assert not correct_cpu_name(device, only_unknown=True)
    assert (name.value, written_cpu_name(device)) == (b"znver3", None)
    assert correct_cpu_name(device)
    assert (name.value, written_cpu_name(device)) == (b"skx", "skx")
    assert better_cpu_name(device) is None
