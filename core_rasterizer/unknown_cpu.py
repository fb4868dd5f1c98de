"""Makes an old PoCL build kernels on a processor that is newer than its compiler.

PoCL asks its LLVM for the name of the host's processor. An LLVM older than the processor answers
"generic", which the same LLVM then refuses as a target, so every build fails (seen with the PoCL 3.0
that pip installs, LLVM 14, on Zen 5). PoCL has no setting for the name, but keeps it as a C string on
the heap, reachable from the device's handle; writing the name of an older processor with the same
instruction sets over it is enough. Memory is only touched through /proc/self/mem, which answers a bad
address with an error instead of a crash, and only if exactly one such string is found.
"""

from __future__ import annotations

import struct
from io import FileIO
from pathlib import Path

import pyopencl as cl

_UNKNOWN = b"generic\0"
_MEMORY = Path("/proc/self/mem")
_HANDLE_BYTES = 4096
"""How much of the driver's device structure is searched for a pointer to the name."""


def teach_processor_name(device: cl.Device) -> bool:
    """Give a PoCL device whose processor LLVM does not know the name of a known one.

    Returns:
        Whether a name was replaced. False on other drivers, on processors that PoCL knows, and
        wherever the string is not found beyond doubt.
    """
    if "Portable Computing Language" not in device.platform.name or not _MEMORY.exists():
        return False
    name = _closest_known_processor()
    if name is None:
        return False
    try:
        with FileIO(_MEMORY, "r+b") as memory:
            addresses = strings_reachable_from(memory, device.int_ptr)
            if len(addresses) != 1:
                return False
            memory.seek(addresses[0])
            memory.write(name)
    except OSError:  # the system does not allow it; building will say what is wrong
        return False
    return True


def _closest_known_processor() -> bytes | None:
    """A name that LLVM 14 knows, at most seven letters, for this machine's instruction sets."""
    flags: set[str] = set()
    for line in Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines():
        if line.startswith("flags"):
            flags = set(line.partition(":")[2].split())
            break
    if {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "clwb", "adx"} <= flags:
        return b"skx\0"
    if {"avx2", "fma", "bmi1", "bmi2", "movbe", "f16c"} <= flags:
        return b"haswell\0"
    return None


def strings_reachable_from(memory: FileIO, handle: int) -> list[int]:
    """Addresses of the string "generic" that the structure at `handle` points to."""
    structure = _peek(memory, handle, _HANDLE_BYTES)
    pointers = {value for (value,) in struct.iter_unpack("<Q", structure)}
    plausible = sorted(p for p in pointers if 0x10000 < p < 1 << 47)
    return [p for p in plausible if _peek(memory, p, len(_UNKNOWN)) == _UNKNOWN]


def _peek(memory: FileIO, address: int, size: int) -> bytes:
    try:
        memory.seek(address)
        data = memory.read(size)
    except (OSError, ValueError):
        return b""
    return data if len(data) % 8 == 0 else data[: len(data) // 8 * 8]
