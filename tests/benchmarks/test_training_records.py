"""What a record of a training says about the machine."""

from __future__ import annotations

import pytest

from benchmarks.training_records import Record, processor


@pytest.mark.parametrize(
    ("model", "built_for", "expected"),
    [
        (None, None, "AMD EPYC"),
        ("family 26", None, "AMD EPYC (family 26)"),
        ("family 25", "skx", "AMD EPYC (family 25, kernels for skx)"),
    ],
)
def test_a_processor_is_named_as_far_as_it_is_known(
    model: str | None, built_for: str | None, expected: str
) -> None:
    device = {"name": "pthread-AMD EPYC"} | ({"built_for": built_for} if built_for else {})
    record = Record(None, {"device": device, "processor_model": model})
    assert processor(record) == expected
