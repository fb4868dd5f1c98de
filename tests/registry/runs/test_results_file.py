"""A forged or damaged results.json is refused by every reader."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from registry import RunError
from registry.runs.folder import RunFolder
from registry.runs.results import read_results
from registry.testing import tiny_scene
from stereogs_plugins.reports.html import HtmlReport
from tests.host import main, to_yaml
from tests.stereogs.experiments.comparing.conftest import PIPELINE, changed
from tests.stereogs_plugins.building import build

RESULTS: dict[str, Any] = {
    "pipeline": "plain",
    "protocol": None,
    "scene": {
        "name": "fern",
        "train": ["a"],
        "test": ["b", "c"],
        "width": 504,
        "height": 378,
        "extent": 4.25,
        "near": 1.0,
        "far": 9.0,
        "points": 700,
        "facts": {"source": "images_8"},
        "notes": {},
    },
    "metrics": {"psnr": {"use": "psnr"}, "lpips": {"use": "lpips"}},
    "device": {"name": "cpu"},
    "seed": 0,
    "iterations": 1000,
    "gaussians": 1000,
    "hash": "0123456789abcdef" * 4,
    "initialization": {"points": 700},
    "seconds": 60.0,
    "seconds_total": 61.5,
    "stages": {"training": 60.0},
    "iterations_per_second": 16.7,
    "peak_memory_mb": None,
    "exports": ["exports/scene.ply"],
    "reports": [],
    "changed_inputs": [],
    "test": {"psnr": 21.0, "lpips": None},
    "train": {"psnr": None, "lpips": None},
    "views": {
        "test": {"b": {"psnr": 20.0, "lpips": None}, "c": {"psnr": 22.0, "lpips": None}},
        "train": {"a": {"psnr": None, "lpips": None}},
    },
    "unavailable": {"lpips": "there is no network"},
}
FORGED: dict[str, tuple[str, Any]] = {
    "a mean that is none": ("test/psnr", 99.0),
    "a mean that was infinite": ("train/psnr", 99.0),
    "a score without its mean": ("views/test/b/psnr", 29.0),
    "an infinite score in a finite mean": ("views/test/b/psnr", None),
    "a mean where no view has a score": ("test/lpips", 0.1),
    "a mean of a metric that no view has": ("test/ssim", 1.0),
    "a view that is gone": ("views/test/b", ...),
    "a view that is new": ("views/test/d", {"psnr": 21.0, "lpips": None}),
    "all views gone": ("views/test", {}),
    "views that are a list": ("views/test", [1]),
    "a score that is text": ("test/psnr", "21.0"),
    "a score that is true": ("test/psnr", True),
    "a score that is a list": ("test/psnr", [21.0]),
    "a score that is no number": ("test/psnr", float("nan")),
    "an infinite score": ("test/psnr", float("inf")),
    "scores that are a list": ("test", [21.0]),
    "scores that are nothing": ("train", None),
    "a scene that is text": ("scene", "fern"),
    "a scene without a name": ("scene/name", ...),
    "a scene whose name is a number": ("scene/name", 3),
    "facts that are a list": ("scene/facts", []),
    "an escape code in a name": ("scene/name", "\x1b[2Jfern"),
    "an escape code in a fact": ("scene/facts/source", "\x1b]0;x\x07"),
    "an escape code in a key": ("scene/notes/\x9b2J", 1),
    "a pipeline that is nothing": ("pipeline", None),
    "a protocol without a name": ("protocol", {"modified": {}}),
    "a protocol whose changes are a list": ("protocol", {"name": "llff-3", "modified": []}),
    "metrics that are names": ("metrics", ["psnr"]),
    "a metric that is text": ("metrics/psnr", "psnr"),
    "fewer Gaussians than none": ("gaussians", -1),
    "half a Gaussian": ("gaussians", 0.5),
    "time that runs back": ("seconds", -1.0),
    "endless time": ("seconds", float("inf")),
    "memory that is text": ("peak_memory_mb", "500"),
    "a hash of another length": ("hash", "0123"),
    "a hash with other letters": ("hash", "x" * 64),
    "another number of scored views": ("train_scored", 3),
    "a reason that is a number": ("unavailable/lpips", 3),
    "exports that are text": ("exports", "scene.ply"),
}


def forged(path: str, value: Any) -> dict[str, Any]:
    """Return the results with a value changed; `...` removes it."""
    return changed(RESULTS, {path: value})


def written(folder: Path, content: str) -> Path:
    run = RunFolder(folder / "run")
    run.create(to_yaml(PIPELINE), {}, {}, lambda folder: None)
    (run.path / "results.json").write_text(content, "utf-8")
    return run.path


def test_valid_results_are_read(tmp_path: Path) -> None:
    path = written(tmp_path, json.dumps(RESULTS)) / "results.json"
    assert read_results(path) == RESULTS


@pytest.mark.parametrize(("path", "value"), FORGED.values(), ids=list(FORGED))
def test_forged_results_are_refused(
    path: str, value: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = written(tmp_path, json.dumps(forged(path, value)))
    with pytest.raises(RunError, match="is inconsistent") as caught:
        read_results(run / "results.json")
    assert caught.value.where == str(run / "results.json")
    assert "stereogs eval" in caught.value.fix
    assert main(["compare", str(run)]) == 2
    said = capsys.readouterr().err
    assert "is inconsistent" in said
    assert "\x1b" not in said
    with pytest.raises(RunError, match="is inconsistent"):
        build(HtmlReport).write(run, tiny_scene())


@pytest.mark.parametrize(
    "content",
    [
        "",
        "{",
        "[1]",
        "null",
        "[" * 100_000,
        '{"gaussians": 1, "gaussians": 2}',
        '{"gaussians": ' + "9" * 5000 + "}",
        '{"pipeline": "\\ud800"}',
        '{"more": [' + "0," * 6_000_000 + "0]}",
    ],
    ids=lambda content: content[:20],
)
def test_content_that_is_not_a_json_object_is_refused(content: str, tmp_path: Path) -> None:
    (tmp_path / "results.json").write_text(content, "utf-8")
    with pytest.raises(RunError, match="is inconsistent"):
        read_results(tmp_path / "results.json")


def test_a_path_that_is_not_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "results.json").symlink_to("/dev/zero")
    with pytest.raises(RunError, match="no such file"):
        read_results(tmp_path / "results.json")
