"""Records of trainings: the file and the name of the processor."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks.training_records import Record, processor, read, save


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


def planned(name: str) -> Any:
    return SimpleNamespace(name=name, identity={"seed": 0}, digest="0123456789")


def test_lines_are_sorted_and_a_new_record_replaces_its_line(tmp_path: Path) -> None:
    file = tmp_path / "records" / "some.jsonl"
    for name, psnr in (("b", 1.0), ("a", 2.0), ("b", 3.0)):
        save(planned(name), {"scores": {"psnr": psnr}}, file)
    lines = [json.loads(line) for line in file.read_text("utf-8").splitlines()]
    assert [(line["name"], line["scores"]["psnr"]) for line in lines] == [("a", 2.0), ("b", 3.0)]
    assert lines[0] == {
        "name": "a",
        "seed": 0,
        "pipeline": "0123456789",
        "scores": {"psnr": 2.0},
    }
    assert [path.name for path in file.parent.iterdir()] == ["some.jsonl"]
    (record,) = read([planned("b"), planned("c")], file)
    assert record.measured == {"seed": 0, "scores": {"psnr": 3.0}}
