"""A device whose compiler optimizes the plain kernels only: without, it takes a fifth of its time."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cache, cached_property
from typing import Any

import pyopencl as cl
import pytest
import torch

from core_rasterizer import Device, open_device
from core_rasterizer.device import KernelText, Program, Variant

OPTIMIZE = "OPTIMIZE"
"""Environment variable; `make runtimes` sets it, and everything is compiled as for runs."""
_FEATURES = {"FADED", "POSED", "SMOOTHED", "COMPENSATED", "ABSOLUTE"}
"""Macros of the projection and blending kernels; each set of them is another program."""


_Program = cl.Program
"""Not that of the class below."""


@cache
def _built(context: cl.Context, text: str, options: tuple[str, ...], more: str | None) -> Any:
    """A program; `more`: PYOPENCL_BUILD_OPTIONS."""
    return _Program(context, text).build(options=list(options))


class _BuiltOnce:
    """A program that all variants of a device share; each creates its own kernels from it."""

    def __init__(self, context: cl.Context, text: str) -> None:
        self._context, self._text = context, text

    def build(self, options: Sequence[str]) -> Any:
        more = os.environ.get("PYOPENCL_BUILD_OPTIONS")
        return _built(self._context, self._text, tuple(options), more)


class QuickDevice(Device):
    """On a CPU, optimizes the kernels of its variant in single precision, without options or plugins' code.

    Args:
        everything: do not optimize the other kernels either, for tests that build many variants of them.
    """

    def __init__(
        self, like: Device, variant: Variant, shares_memory: bool, everything: bool = False
    ) -> None:
        super().__init__(like._handle, variant, shares_memory)
        self._everything = everything

    def as_variant(self, variant: Variant) -> QuickDevice:
        return QuickDevice(self, variant, self.shares_memory, self._everything)

    def as_discrete(self) -> QuickDevice:
        return QuickDevice(self, self.variant, False, self._everything)

    @cached_property
    def unoptimized(self) -> QuickDevice:
        """The same device, which optimizes no kernel."""
        return QuickDevice(self, self.variant, self.shares_memory, True)

    def _build(
        self, sources: tuple[str | KernelText, ...], dtype: torch.dtype, defines: Any
    ) -> Program:
        plain = not _FEATURES & set(defines) and all(isinstance(source, str) for source in sources)
        single = dtype == torch.float32 and self.variant == "cpu"
        optimized = single and plain and not self._everything
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(cl, "Program", _BuiltOnce)
            if self.kind == "cpu" and OPTIMIZE not in os.environ and not optimized:
                patch.setenv("PYOPENCL_BUILD_OPTIONS", "-cl-opt-disable")
            return super()._build(sources, dtype, defines)


@cache
def quick_device() -> QuickDevice:
    """Return the default device as a `QuickDevice`."""
    device = open_device()
    return QuickDevice(device, device.variant, device.shares_memory)
