"""Weights & Biases' own files, read as its format says: protobuf records in a log like LevelDB's."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from registry.testing import check
from stereogs_plugins.observers.wandb import WandbObserver
from tests.stereogs_plugins.observers.heard import CURVES, failed, stopped_and_resumed

pytest.importorskip("wandb")
_BLOCK, _FILE_HEADER, _HEADER = 32768, 7, struct.Struct("<IHB")
_FULL, _FIRST, _MIDDLE, _LAST = 1, 2, 3, 4


def payloads(file: Path) -> Iterator[bytes]:
    content = file.read_bytes()
    assert content[:4] == b":W&B"
    at, parts = _FILE_HEADER, b""
    while at + _HEADER.size <= len(content):
        left = _BLOCK - at % _BLOCK
        if left < _HEADER.size:
            at += left
            continue
        _, length, kind = _HEADER.unpack_from(content, at)
        parts += content[at + _HEADER.size : at + _HEADER.size + length]
        at += _HEADER.size + length
        if kind in (_FULL, _LAST):
            yield parts
            parts = b""


def records(file: Path) -> list[Any]:
    """All of a file; its last record, "exit", is on the disk soon after the run is finished."""
    proto = pytest.importorskip("wandb.proto.wandb_internal_pb2")
    for _ in range(100):
        found = [proto.Record.FromString(payload) for payload in payloads(file)]
        if found and kind(found[-1]) == "exit":
            return found
        time.sleep(0.1)
    raise AssertionError(f"{file} has no end")


def kind(record: Any) -> str | None:
    name: str | None = record.WhichOneof("record_type")
    return name


def history(file: Path) -> dict[int, dict[str, Any]]:
    """What was logged, by step."""
    found: dict[int, dict[str, Any]] = {}
    for record in records(file):
        if kind(record) == "history":
            row = {
                "/".join(item.nested_key) or item.key: json.loads(item.value_json)
                for item in record.history.item
            }
            found.setdefault(int(row["_step"]), {}).update(row)
    return found


def test_it_keeps_the_contract() -> None:
    check(WandbObserver)


def test_what_was_told_is_in_its_files(tmp_path: Path) -> None:
    run, folder = stopped_and_resumed("wandb", tmp_path / "run")
    files = sorted(folder.glob("wandb/offline-run-*/run-*.wandb"))
    assert [file.stem for file in files] == [f"run-{run.identity}"] * 2, "one run in two parts"
    steps: dict[int, dict[str, Any]] = {}
    for file in files:
        steps |= history(file)
    assert {2, 4, 6} == steps.keys()
    assert steps[6].keys() >= CURVES
    assert steps[6]["gaussians"] == run.model.count
    assert steps[6]["test/psnr"] == pytest.approx(run.scores["test"].mean["psnr"])
    (picture,) = folder.glob("wandb/*/files/media/images/views/*.png")
    view = picture.name.partition("_")[0]
    assert [name for name in steps[4] if name.endswith("/path")] == [f"views/{view}/path"]
    begun = next(record.run for record in records(files[0]) if kind(record) == "run")
    config = {item.key: json.loads(item.value_json) for item in begun.config.update}
    assert config["pipeline"]["training"]["iterations"] == 6
    assert begun.project == "stereogs"


def test_a_run_that_fails_has_failed_there_too(tmp_path: Path) -> None:
    (file,) = failed("wandb", tmp_path / "run").glob("wandb/offline-run-*/run-*.wandb")
    assert records(file)[-1].exit.exit_code == 1
    said = [item for r in records(file) for item in r.summary.update if item.key == "error"]
    assert "no such luck" in said[0].value_json
