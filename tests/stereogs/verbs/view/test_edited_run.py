"""A run that is saved from what remains after an edit by hand."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import stereogs
from core_rasterizer import GaussianError
from registry import RunError
from stereogs import Run
from stereogs.verbs.view.edited_run import save_edited
from stereogs.verbs.view.subject import of_run
from tests.host import comparable_groups, labels, main, read_run
from tests.registry.conftest import TOY_ENTRIES, Install

PIPELINE = """\
name: toy
scene: toy_scene
initializer: {use: toy_points, kinds: true}
densification: {use: toy_growth, every: 10, stop: 25}
regularizers: [{use: toy_term, weight: 0.1}]
metrics: [psnr]
exporters: [toy_files]
reports: [toy_report]
training: {iterations: 30, sh_degree: 1, sh_every: 10, seed: 3}
"""


@pytest.fixture(autouse=True)
def _toys(install: Install) -> None:
    install("toys", "1.5", TOY_ENTRIES)


def trained(path: Path, until: int = 30) -> Run:
    stereogs.train(PIPELINE, out=path, progress=False, callback=lambda done: done.number < until)
    return stereogs.open_run(path)


def every_third_removed(run: Run) -> torch.Tensor:
    return torch.arange(run.engine_model.count) % 3 > 0


def test_it_is_scored_anew_and_says_what_was_removed(tmp_path: Path) -> None:
    run = trained(tmp_path / "run")
    kept, before = every_third_removed(run), run.folder_or_refuse().results()
    path = save_edited(run, kept)
    assert path == tmp_path / "run-edited"
    assert save_edited(run, kept) == tmp_path / "run-edited-2"
    edited = stereogs.open_run(path)
    whole, part = vars(run.model.gaussians()), vars(edited.model.gaussians())
    assert all(part[name].equal(values[kept]) for name, values in whole.items())
    assert {k: len(v) for k, v in edited.kinds.items()} == dict.fromkeys(run.kinds, int(kept.sum()))

    results = edited.folder_or_refuse().results()
    assert results["hash"] == edited.hash != run.hash
    assert results["test"]["psnr"] == pytest.approx(edited.evaluate()["test"].mean["psnr"])
    assert results["test"]["psnr"] != before["test"]["psnr"]
    assert results["failures"] == []
    assert not (path / "metrics.jsonl").exists(), "curves of other Gaussians"
    (edit,) = results["edits"]
    provenance = json.loads((path / "provenance.json").read_text("utf-8"))
    assert provenance["edits"] == [edit]
    assert provenance["run"] not in ("", run.identity)
    assert (edit["run"], edit["folder"], edit["hash"]) == (run.identity, "run", run.hash)
    assert (edit["gaussians"], edit["removed"]) == (len(kept), int((~kept).sum()))

    groups = comparable_groups([read_run(run.folder_or_refuse().path), read_run(path)])
    assert len(groups) == 1
    assert (
        labels(groups[0][0])[1]
        == f"toy, edited={edit['removed']} removed by hand ({edited.hash[:8]})"
    )
    for verb in ("render", "eval", "report"):
        assert main([verb, str(path)]) == 0
    assert stereogs.resume(path, progress=False).hash == edited.hash


def test_an_unfinished_run_continues_after_the_edit(tmp_path: Path) -> None:
    run = trained(tmp_path / "run", until=12)
    source = of_run(run).source
    assert source is not None
    assert source.save_run is not None
    path = source.save_run(every_third_removed(run))
    twice = save_edited(
        stereogs.open_run(path), torch.arange(len(every_third_removed(stereogs.open_run(path)))) > 0
    )
    done = stereogs.resume(twice, progress=False)
    assert done.finished
    assert [edit["removed"] for edit in done.folder_or_refuse().results()["edits"]][1:] == [1]


def test_a_run_without_its_photographs_is_not_saved(tmp_path: Path) -> None:
    run = replace(trained(tmp_path / "run"), photographs=False)
    with pytest.raises(RunError, match="photographs"):
        save_edited(run, every_third_removed(run))
    with pytest.raises(GaussianError, match="remove all"):
        save_edited(
            replace(run, photographs=True), torch.zeros(run.engine_model.count, dtype=torch.bool)
        )
    assert not list(tmp_path.glob("run-edited*"))
