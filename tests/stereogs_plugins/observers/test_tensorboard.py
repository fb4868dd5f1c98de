from __future__ import annotations

from pathlib import Path

import pytest

from registry.testing import check
from stereogs_plugins.observers.tensorboard import TensorBoardObserver
from tests.stereogs_plugins.observers.heard import CURVES, failed, stopped_and_resumed


def accumulated(folder: Path):  # type: ignore[no-untyped-def]
    """What TensorBoard itself makes of the event files in a folder."""
    module = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    events = module.EventAccumulator(str(folder), size_guidance={"scalars": 0, "images": 0})
    return events.Reload()


def test_it_keeps_the_contract() -> None:
    pytest.importorskip("tensorboard")
    check(TensorBoardObserver)


def test_tensorboard_reads_what_was_told(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    run, folder = stopped_and_resumed("tensorboard", tmp_path / "run")
    events = accumulated(folder)
    tags = events.Tags()
    assert {*tags["scalars"]} >= CURVES | {"test/psnr", "train/psnr"}
    assert [event.step for event in events.Scalars("loss")] == [2, 4, 6]
    last = events.Scalars("gaussians")[-1]
    assert last.value == run.model.count
    scores = {event.step: event.value for event in events.Scalars("test/psnr")}
    assert scores.keys() == {4, 6}
    assert scores[6] == pytest.approx(run.scores["test"].mean["psnr"])
    (picture,) = tags["images"]
    assert [event.step for event in events.Images(picture)] == [4]
    assert {"pipeline/text_summary", "facts/text_summary"} <= {*tags["tensors"]}


def test_the_error_is_in_the_file(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    (event,) = accumulated(failed("tensorboard", tmp_path / "run")).Tensors("error/text_summary")
    assert b"no such luck" in event.tensor_proto.string_val[0]
