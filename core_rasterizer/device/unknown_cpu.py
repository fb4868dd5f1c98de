"""Corrects the processor name of an old PoCL whose compiler does not know the processor.

PoCL uses the processor name that its LLVM detects. An LLVM older than the processor detects "generic",
which it then rejects as a target, so every build fails (PoCL 3.0 from pip, LLVM 14, on Zen 5). Or it
detects the predecessor and uses half of the registers (Zen 4 as Zen 3: `raster_backward` took a third
longer). PoCL has no setting for the name but keeps it as a C string on the heap, reachable from the
device's handle. This module overwrites it with an older processor of the same instruction sets, through
/proc/self/mem, where a bad address is an error and not a crash, and only if exactly one such string is
found.

Because this is another library's memory, it happens only after a build has failed for such a name, or
for speed if STEREOGS_CORRECT_CPU_NAME=1.
"""

from __future__ import annotations

import struct
from io import FileIO
from pathlib import Path
from typing import NamedTuple

import pyopencl as cl

_UNKNOWN = b"generic\0"
_WITHOUT_AVX512 = b"znver3\0"
"""LLVM 14 also reports this for Zen 4."""
_MEMORY = Path("/proc/self/mem")
_HANDLE_BYTES = 4096
"""Length of the driver's device structure that is searched for a pointer to the name."""
_written: dict[int, str] = {}
"""Names that we wrote, by the device's handle."""
_AVX512 = frozenset(("avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "clwb", "adx"))
_AVX2 = frozenset(("avx2", "fma", "bmi1", "bmi2", "movbe", "f16c"))


def correct_cpu_name(device: cl.Device, *, only_unknown: bool = False) -> bool:
    """Replace the processor name of a PoCL device by one that LLVM knows.

    Args:
        only_unknown: If True, keep a name that LLVM can build for.

    Returns:
        True if the name was replaced. False on other drivers, for processors that PoCL knows, and if
        the string is not found unambiguously.
    """
    try:
        found = _name_to_replace(device)
        if found is None or (only_unknown and found.name != _UNKNOWN):
            return False
        with FileIO(_MEMORY, "r+b") as memory:
            memory.seek(found.address)
            memory.write(found.better)
    except OSError:  # not permitted; the build will report its error
        return False
    _written[device.int_ptr] = _text(found.better)
    return True


def better_cpu_name(device: cl.Device) -> str | None:
    """The name that `correct_cpu_name` would write, or None."""
    try:
        found = _name_to_replace(device)
    except OSError:
        return None
    return None if found is None else _text(found.better)


def written_cpu_name(device: cl.Device) -> str | None:
    """The name that `correct_cpu_name` wrote for this device, or None."""
    return _written.get(device.int_ptr)


class _Found(NamedTuple):
    """Address of the driver's name, the name and its replacement, as C strings."""

    address: int
    name: bytes
    better: bytes


def _name_to_replace(device: cl.Device) -> _Found | None:
    """The driver's processor name, if it is found unambiguously and a better one exists.

    Raises:
        OSError: reading the memory is not permitted.
    """
    if "Portable Computing Language" not in device.platform.name or not _MEMORY.exists():
        return None
    with FileIO(_MEMORY, "rb") as memory:
        found = names_reachable_from(memory, device.int_ptr)
    if len(found) != 1:
        return None
    address, name = found[0]
    better = better_name(name, _processor_flags())
    return None if better is None else _Found(address, name, better)


def _text(name: bytes) -> str:
    return name.rstrip(b"\0").decode()


def better_name(name: bytes, flags: frozenset[str]) -> bytes | None:
    """A name known to LLVM 14, no longer than `name`, for a processor with these instruction sets.

    Returns:
        A C string, or None if `name` is as good.
    """
    if flags >= _AVX512:
        return b"skx\0"
    if name == _UNKNOWN and flags >= _AVX2:
        return b"haswell\0"
    return None


def _processor_flags() -> frozenset[str]:
    """Linux's names for this machine's instruction sets."""
    for line in Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines():
        if line.startswith("flags"):
            return frozenset(line.partition(":")[2].split())
    return frozenset()


def names_reachable_from(memory: FileIO, handle: int) -> list[tuple[int, bytes]]:
    """Addresses of replaceable names that the structure at `handle` points to, with these names."""
    structure = _peek(memory, handle, _HANDLE_BYTES)
    pointers = {value for (value,) in struct.iter_unpack("<Q", structure)}
    found = []
    for pointer in sorted(p for p in pointers if 0x10000 < p < 1 << 47):
        text = _peek(memory, pointer, len(_UNKNOWN))
        found += [(pointer, n) for n in (_UNKNOWN, _WITHOUT_AVX512) if text.startswith(n)]
    return found


def _peek(memory: FileIO, address: int, size: int) -> bytes:
    try:
        memory.seek(address)
        data = memory.read(size)
    except (OSError, ValueError):
        return b""
    return data if len(data) % 8 == 0 else data[: len(data) // 8 * 8]
