from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from registry.testing import check, tiny_scene
from stereogs_plugins.observers.rerun import RerunObserver
from tests.stereogs_plugins.observers.heard import CURVES, failed, stopped_and_resumed

pytest.importorskip("rerun")


def batches(file: Path) -> dict[str, list[Any]]:
    """What Rerun's own reader finds in a file: Arrow record batches by entity."""
    chunk = pytest.importorskip("rerun.chunk")
    found: dict[str, list[Any]] = {}
    for part in chunk.RrdReader(file).stream():
        found.setdefault(str(part.entity_path), []).append(part.to_record_batch())
    return found


def column(batches_of: list[Any], ending: str) -> list[Any]:
    return [
        value
        for batch in batches_of
        for name in batch.schema.names
        if name.endswith(ending)
        for value in batch.column(name).to_pylist()
    ]


def test_it_keeps_the_contract() -> None:
    check(RerunObserver)


def test_rerun_reads_what_was_told(tmp_path: Path) -> None:
    run, folder = stopped_and_resumed("rerun", tmp_path / "run")
    first, second = sorted(folder.glob("*.rrd"))
    assert (first.name, second.name) == ("after-0000000.rrd", "after-0000004.rrd")
    scene, before, after = tiny_scene(), batches(first), batches(second)
    assert {f"/curves/{name}" for name in CURVES} <= before.keys() & after.keys()
    assert column(before["/curves/loss"], "iteration") == [2, 4]
    assert column(after["/curves/loss"], "iteration") == [6]
    assert column(after["/curves/gaussians"], "scalars") == [[run.model.count]]
    (score,) = column(after["/curves/test/psnr"], "scalars")
    assert score[0] == pytest.approx(run.scores["test"].mean["psnr"])
    for view in scene.train:
        here = before[f"/world/cameras/{view.name}"]
        (center,) = column(here, "translation")
        assert np.allclose(center[0], view.camera.center)
        assert column(here, "resolution") == [[[view.camera.width, view.camera.height]]]
        (pixels,) = column(here, "buffer")
        assert len(pixels[0]) == view.image.numel()
    assert scene.points is not None
    (points,) = column(before["/world/points"], "positions")
    assert np.allclose(points, scene.points.positions)
    assert column(before["/world/gaussians"], "iteration") == [4]


def test_the_error_is_in_the_file(tmp_path: Path) -> None:
    (file,) = failed("rerun", tmp_path / "run").glob("*.rrd")
    assert "no such luck" in str(column(batches(file)["/error"], "text"))
