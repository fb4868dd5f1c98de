"""`make gpu` where there is no GPU, and its tables in the docs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import gpu, pages
from core_rasterizer import open_device


@pytest.mark.proof
def test_without_a_gpu_everything_runs_at_a_tiny_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", "")
    monkeypatch.setattr(gpu, "NEEDLES", ("--version",))  # they are tests of this suite
    file = tmp_path / "gpu.json"
    record = gpu.measure(open_device(), gpu.TINY, file)
    assert json.loads(file.read_text()) == record
    (made,) = record["engine"].values()
    assert 0 < made["host"] < made["wall"]
    assert set(made["kernels"]) > {"project", "raster", "raster_backward"}
    assert record["tests"]["self-test"]["gradient_error"] < 1e-4
    assert "pytest" in "".join(record["tests"]["needles"])
    (missing,) = record["gsplat"].values()
    assert isinstance(missing, str)
    text = gpu.tables(record)
    assert "| kernels but loss |" in text
    assert "| `demo` |" in text
    assert "gsplat" not in text


def test_the_page_shows_the_record() -> None:
    record = json.loads(gpu.RECORD.read_text("utf-8"))
    begin, end = pages.marks(gpu.TARGET)
    shown = gpu.PAGE.read_text("utf-8").partition(begin)[2].partition(end)[0]
    assert shown.strip() == gpu.tables(record, gpu.SUMMARY).strip()
