"""docs/engine.md names every kernel, and arrays that its kernels have."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

import core_rasterizer
from core_rasterizer.device.signature import signatures
from core_rasterizer.layout import KERNEL_HEADER

PACKAGE = Path(core_rasterizer.__file__).parent
PAGE = (PACKAGE.parent / "docs" / "engine.md").read_text("utf-8")


def arguments_by_kernel() -> dict[str, set[str]]:
    """Of all variants of a kernel."""
    found: dict[str, set[str]] = {}
    for file in PACKAGE.glob("*/kernels/*.cl"):
        for name, kernel in signatures(KERNEL_HEADER + file.read_text("utf-8"), np.float32).items():
            found.setdefault(name, set()).update(kernel.names)
    return found


def test_the_page_names_every_kernel_and_existing_arguments() -> None:
    kernels, named = arguments_by_kernel(), set()
    rows = re.findall(r"^\| [^|]+ \| (`[^|]+) \| (`[^|]+) \| (`[^|]+) \|$", PAGE, re.MULTILINE)
    assert len(rows) == 17
    for row in rows:
        used, *arrays = (re.findall(r"`(\w+)`", cell) for cell in row)
        named.update(used)
        arguments = set().union(*(kernels[name] for name in used))
        for array in (name for cell in arrays for name in cell):
            assert array in arguments, f"{', '.join(used)}: {array}"
    others = PAGE.partition("Edits of the set")[2].partition("## Arrays")[0]
    named.update(re.findall(r"`(\w+)`", others))
    assert named == set(kernels)
