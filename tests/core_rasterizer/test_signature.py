"""Arguments of kernels are bound by name."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
import torch

from core_rasterizer import Device, ExplainedError
from core_rasterizer.device import DeviceArray, Program
from core_rasterizer.device.signature import signatures

SOURCE = """
#define RATES real first, \\
    real second
/* __kernel void old(int gone) */
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void step(
    __global const real *restrict values, // real comment,
    __global uint *counts /* a, b */, RATES, int rows,
    uint columns)
{
}
__kernel void empty_rows(__global uchar *rows) {}
"""


def scan(device: Device) -> tuple[Program, dict[str, Any]]:
    """A kernel that reads `counts` and writes `totals`, and its arguments."""
    program = device.program("raster/scan", dtype=torch.float32, SCAN_GROUP=16, SCAN_ITEMS=1)
    arrays = {name: DeviceArray(device, (16,), torch.int32) for name in ("counts", "totals")}
    arrays["counts"].write(torch.arange(16))
    return program, {**arrays, "buckets": 16, "chunks": 1}


def test_names_and_types_are_read_from_the_source() -> None:
    found = signatures(SOURCE, np.float32)
    assert set(found) == {"step", "empty_rows"}
    assert found["step"].names == ("values", "counts", "first", "second", "rows", "columns")
    assert found["step"].types == [None, None, np.float32, np.float32, np.int32, np.uint32]


def test_the_order_of_names_does_not_matter(device: Device) -> None:
    program, arguments = scan(device)
    program.run("scan_chunks", (16,), (16,), **dict(reversed(arguments.items())))
    assert arguments["totals"].read().tolist() == list(range(16))


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"chunks": None}, "launched without chunks$"),
        ({"rows": 3}, "launched with the unknown rows$"),
        ({"totals": None, "sums": 1}, "launched without totals and with the unknown sums$"),
        ({"totals": 1}, "wrong types: .*'totals': 'int'"),
        ({"buckets": 1.5}, "wrong types: .*'buckets': 'float'"),
    ],
)
def test_a_wrong_argument_is_named(device: Device, change: dict[str, Any], what: str) -> None:
    program, arguments = scan(device)
    wrong = {name: each for name, each in {**arguments, **change}.items() if each is not None}
    with pytest.raises(ExplainedError) as error:
        program.run("scan_chunks", (16,), (16,), **wrong)
    assert re.search(what, error.value.what)
    assert error.value.fix == "it takes counts, totals, buckets, chunks"
