"""Tells an old PoCL which processor it builds kernels for, where its compiler is too old to know.

PoCL asks its LLVM for the name of the host's processor. An LLVM older than the processor answers
"generic", which the same LLVM then refuses as a target, so every build fails (seen with the PoCL 3.0
that pip installs, LLVM 14, on Zen 5); or it takes the processor for its predecessor, so that half of
the registers lie idle (Zen 4, taken for Zen 3: `raster_backward` took a third longer). PoCL has
no setting for the name, but keeps it as a C string on the heap, reachable from the device's handle;
writing the name of an older processor with the same instruction sets over it is enough. Memory is
only touched through /proc/self/mem, which answers a bad address with an error instead of a crash, and
only if exactly one such string is found.

That is another program's memory, so it happens only after a build has failed for such a name, or for
speed when STEREOGS_CORRECT_CPU_NAME asks for it.
"""

from __future__ import annotations

import struct
from io import FileIO
from pathlib import Path
from typing import NamedTuple

import pyopencl as cl

_UNKNOWN = b"generic\0"
_WITHOUT_AVX512 = b"znver3\0"
"""What LLVM 14 calls Zen 4, too."""
_MEMORY = Path("/proc/self/mem")
_HANDLE_BYTES = 4096
"""How much of the driver's device structure is searched for a pointer to the name."""
_told: dict[int, str] = {}
"""What stands in the driver's memory since we wrote it, by the device's handle."""
_AVX512 = frozenset(("avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "clwb", "adx"))
_AVX2 = frozenset(("avx2", "fma", "bmi1", "bmi2", "movbe", "f16c"))


def correct_cpu_name(device: cl.Device, *, only_unknown: bool = False) -> bool:
    """Give a PoCL device whose processor LLVM does not know the name of a known one.

    Args:
        only_unknown: leave a name alone that LLVM can build for, though it says too little.

    Returns:
        Whether a name was replaced. False on other drivers, on processors that PoCL knows, and
        wherever the string is not found beyond doubt.
    """
    try:
        found = _name_to_replace(device)
        if found is None or (only_unknown and found.name != _UNKNOWN):
            return False
        with FileIO(_MEMORY, "r+b") as memory:
            memory.seek(found.address)
            memory.write(found.better)
    except OSError:  # the system does not allow it; building will say what is wrong
        return False
    _told[device.int_ptr] = _text(found.better)
    return True


def better_cpu_name(device: cl.Device) -> str | None:
    """The processor that `correct_cpu_name` would write down; None where it would leave the name alone."""
    try:
        found = _name_to_replace(device)
    except OSError:
        return None
    return None if found is None else _text(found.better)


def told_cpu_name(device: cl.Device) -> str | None:
    """The processor that `correct_cpu_name` wrote down for this device, None where it never did."""
    return _told.get(device.int_ptr)


class _Found(NamedTuple):
    """Where the driver keeps a name, and the one that should stand there; both names are C strings."""

    address: int
    name: bytes
    better: bytes


def _name_to_replace(device: cl.Device) -> _Found | None:
    """The driver's name of the processor, if it is found beyond doubt and another one says more.

    Raises:
        OSError: the system does not let us look.
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
    """A name that LLVM 14 knows, no longer than `name`, for a processor with these instruction sets.

    Returns:
        A C string, or None where `name` says as much.
    """
    if flags >= _AVX512:
        return b"skx\0"
    if name == _UNKNOWN and flags >= _AVX2:
        return b"haswell\0"
    return None


def _processor_flags() -> frozenset[str]:
    """Linux's names of this machine's instruction sets."""
    for line in Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines():
        if line.startswith("flags"):
            return frozenset(line.partition(":")[2].split())
    return frozenset()


def names_reachable_from(memory: FileIO, handle: int) -> list[tuple[int, bytes]]:
    """Addresses of names that say too little, of those that the structure at `handle` points to."""
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
