"""The checkpoint before a failed iteration is kept, and the iteration can be repeated to the same bits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from core_rasterizer import Device, ExplainedError
from registry import PluginError, RunError, Step
from stereogs import RunOptions
from stereogs.verbs.replay import repeat_failure as replay
from tests.host import Plugins, parse_pipeline, read_checkpoint, start_run, write_checkpoint
from tests.registry.toy_plugin import ToyTerm

TEXT = """\
name: toy
scene: toy_scene
initializer: toy_points
modifiers: [toy_dropout]
densification: {use: toy_growth, every: 4}
opacity: {use: toy_fade, every: 3}
regularizers:
  - {use: toy_term, weight: 0.1}
  - {use: toy_term, name: late, start: 11, fault: FAULT}
training: {iterations: 12, sh_degree: 1, checkpoint_every: 5}
"""
FAILED = "iteration-0000011"


def train(plugins: Plugins, device: Device, out: Path | None, fault: str) -> ExplainedError | None:
    """Train into a folder; return the error that ends the training, if any."""
    pipeline = parse_pipeline(TEXT.replace("FAULT", fault), plugins, source="toy.yaml")
    try:
        start_run(pipeline, RunOptions(device=device, progress=False), out)
    except ExplainedError as error:
        return error
    return None


@pytest.mark.parametrize("fault", ["gradient", "crash"])
def test_the_checkpoint_before_a_failure_is_kept_and_repeats_the_error(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    first = train(toys, device, tmp_path / "run", fault)
    assert first is not None
    place = tmp_path / "run" / "failures" / FAILED
    assert f"stereogs replay {place}" in first.fix
    with pytest.raises(type(first)) as caught:
        replay(place, plugins=toys, device=device)
    assert caught.value.what == first.what
    lines = (place / "pipeline.yaml").read_text().splitlines()
    number = int(caught.value.where.split("pipeline.yaml:")[1].split(",")[0])
    assert "toy_term" in lines[number - 1]
    assert "iteration 11" in caught.value.where
    monkeypatch.setattr(ToyTerm, "loss", lambda self, step: step.rendering.alpha.mean())
    mended = replay(place / "manifest.json", plugins=toys, device=device)
    assert (mended.iteration, mended.what) == (11, first.what)


def test_the_kept_checkpoint_has_the_bits_of_a_run_that_did_not_fail(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    assert train(toys, device, tmp_path / "bad", "nan") is not None
    assert train(toys, device, tmp_path / "good", "none") is None
    kept = read_checkpoint(tmp_path / "bad" / "failures" / FAILED)
    sound = read_checkpoint(tmp_path / "good" / "checkpoint" / "iteration-0000010")
    assert kept.iteration == sound.iteration == 10
    assert kept.tensors.keys() == sound.tensors.keys()
    assert [n for n, t in sound.tensors.items() if not torch.equal(t, kept.tensors[n])] == []


def test_if_training_cannot_be_repeated_the_newest_checkpoint_is_kept(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[int] = []

    def loss(self: ToyTerm, step: Step) -> Any:
        again = 9 in seen
        seen.append(step.iteration)
        if step.iteration == 9 or again:
            raise ZeroDivisionError("not twice the same")
        return step.rendering.alpha.mean()

    monkeypatch.setattr(ToyTerm, "loss", loss)
    assert train(toys, device, tmp_path / "run", "none") is not None
    place = tmp_path / "run" / "failures" / "iteration-0000009"
    assert read_checkpoint(place).iteration == 5
    seen.clear()
    with pytest.raises(PluginError, match="not twice the same"):
        replay(place, plugins=toys, device=device)
    assert seen == [6, 7, 8, 9]


def test_a_run_in_memory_keeps_nothing(toys: Plugins, device: Device) -> None:
    error = train(toys, device, None, "nan")
    assert error is not None
    assert "replay" not in error.fix


def test_a_full_disk_does_not_hide_the_failure(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*arguments: object) -> None:
        raise RunError("No space left on device")

    monkeypatch.setattr("registry.runs.opening.write_checkpoint", full)
    error = train(toys, device, tmp_path / "run", "nan")
    assert error is not None
    assert error.what == "the loss is not finite"
    assert "replay" not in error.fix


def test_folders_without_a_failed_iteration_are_refused(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    train(toys, device, tmp_path / "run", "nan")
    places = {
        "not of a failed iteration": tmp_path / "run" / "checkpoint" / "iteration-0000010",
        "no such folder": tmp_path / "none",
        "not a failed iteration: it has no manifest.json": tmp_path / "run",
    }
    kept = read_checkpoint(tmp_path / "run" / "failures" / FAILED)
    for name, change in (
        (
            "inputs of the run have changed: the points",
            {"inputs": {**kept.notes["inputs"], "the points": ""}},
        ),
        ("iteration 10 does not come after 10", {"iteration": 10}),
        ("iteration 13 does not come after 10 in a run of 12", {"iteration": 13}),
    ):
        places[name] = tmp_path / f"changed-{len(places)}"
        write_checkpoint(replace(kept, notes={**kept.notes, **change}), places[name])
    for message, place in places.items():
        with pytest.raises(RunError, match=message) as caught:
            replay(place, plugins=toys, device=device)
        assert caught.value.fix
