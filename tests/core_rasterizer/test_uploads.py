"""Copies of tensors on the device are dropped with the tensors, whenever these are freed."""

from __future__ import annotations

import gc
from dataclasses import replace
from typing import Any, cast

import torch

from core_rasterizer import Device
from core_rasterizer.device.uploads import Uploads


class Collecting:
    """An array at whose sight the garbage collector runs, as it may at any time."""

    @property
    def nbytes(self) -> int:
        gc.collect()
        return 16


def test_tensors_may_be_freed_while_copies_are_counted(device: Device) -> None:
    uploads = Uploads(device)
    kept = torch.ones(4)
    uploads.of(kept, torch.float32)
    gc.disable()
    try:
        for _ in range(3):
            cycle: list[Any] = [torch.ones(4)]
            cycle.append(cycle)
            uploads.of(cycle[0], torch.float32)
        del cycle
        first = next(iter(uploads._copies))
        collecting = cast(Any, Collecting())
        uploads._copies[first] = replace(uploads._copies[first], array=collecting)
        latest = torch.ones(4)
        assert uploads.of(latest, torch.float32).read().tolist() == [1] * 4
    finally:
        gc.enable()
    assert len(uploads) == 2, "those of the two tensors that remain"
