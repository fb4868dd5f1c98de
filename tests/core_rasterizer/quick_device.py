"""A device whose compiler does not optimize what no run uses, which takes a fifth of its time."""

from __future__ import annotations

import os
from functools import cached_property
from typing import Any

import pytest
import torch

from core_rasterizer import Device
from core_rasterizer.device import KernelText, Program, Variant

OPTIMIZE = "OPTIMIZE"
"""Environment variable; `make runtimes` sets it, and everything is compiled as for runs."""


class QuickDevice(Device):
    """Does not optimize double precision, nor kernels of GPUs on a CPU.

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
        in_runs = dtype == torch.float32 and self.variant == "cpu" and not self._everything
        with pytest.MonkeyPatch.context() as patch:
            if self.kind == "cpu" and not in_runs and OPTIMIZE not in os.environ:
                patch.setenv("PYOPENCL_BUILD_OPTIONS", "-cl-opt-disable")
            return super()._build(sources, dtype, defines)
