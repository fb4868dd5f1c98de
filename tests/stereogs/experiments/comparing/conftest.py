"""Folders of finished runs, written without training."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from stereogs.experiments.comparing.comparability import check_comparable
from stereogs.experiments.comparing.comparison import FinishedRun, read_run
from tests.host import AppliedProtocol, RunFolder, load_protocol, to_yaml, write_json

Capture = pytest.CaptureFixture[str]
Make = Callable[..., Path]
RESULTS: dict[str, Any] = {
    "pipeline": "plain",
    "protocol": AppliedProtocol(load_protocol("llff-3"), {}).record(),
    "scene": {
        "name": "fern",
        "train": ["image001", "image010", "image019"],
        "test": ["image000", "image008", "image016"],
        "width": 504,
        "height": 378,
        "extent": 4.25,
        "points": 700,
        "facts": {"source": "images_8"},
        "notes": {"dark_background": "kept"},
    },
    "metrics": {
        "psnr": {"use": "psnr", "quantize": "png8"},
        "lpips": {"use": "lpips", "quantize": "png8", "sha256": None},
    },
    "gaussians": 1000,
    "seconds": 60.0,
    "peak_memory_mb": 500.0,
    "test": {"psnr": 20.0, "ssim": 0.7, "lpips": None},
}
PIPELINE: dict[str, Any] = {
    "name": "plain",
    "scene": {"use": "llff", "path": "fern", "train_views": 3},
    "initializer": {"use": "sfm"},
    "metrics": [{"use": "psnr"}],
    "training": {"iterations": 1000, "seed": 0},
}


def changed(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """A copy with values at paths such as "scene/name"; `...` removes one."""
    result = copy.deepcopy(base)
    for path, value in changes.items():
        *parents, last = path.split("/")
        place = result
        for parent in parents:
            place = place[parent]
        place[last] = value
        if value is ...:
            del place[last]
    return result


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """`make("a", {"scene/name": "flower"}, {"training/seed": 1})` writes a run folder."""

    def make(
        name: str, results: dict[str, Any] | None = None, pipeline: dict[str, Any] | None = None
    ) -> Path:
        run = RunFolder(tmp_path / name)
        run.create(to_yaml(changed(PIPELINE, pipeline or {})), {}, {}, lambda folder: None)
        write_json(run.path / "results.json", changed(RESULTS, results or {}))
        return run.path

    return make


def runs(*folders: Path) -> list[FinishedRun]:
    found = [read_run(folder) for folder in folders]
    check_comparable(found)
    return found
