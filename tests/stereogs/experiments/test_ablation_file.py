"""Errors in ablation files name the line; the project's own files are valid."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from core_rasterizer import ExplainedError
from stereogs.experiments.planning.description import read_description
from stereogs.experiments.planning.making import make_plan
from tests.host import SELECTION, PipelineError, Plugins
from tests.stereogs.experiments.ablating import plan, write

PIPELINES = Path(__file__).parents[3] / "pipelines"
FILES = sorted((PIPELINES / "ablations").glob("*.yaml"))
COUNTS = {
    "baseline": 9,
    "decay_base": 7,
    "decay_function": 5,
    "multi_view_models": 4,
    "parts": 8,
    "small_multi_view_models": 7,
    "small_stereo_models": 3,
    "stereo_models": 5,
    "stereo_term": 10,
    "validity_mask": 2,
    "weightfree": 14,
}
FULL_LENGTH = [file for file in FILES if file.stem != "weightfree"]
"""Tables of the paper, which `stereogs.yaml` supports too."""


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("togles: {second: }", 2, "did you mean 'toggles'"),
        ("training: {seed: 1}\nseeds: 1", 2, "belongs in the pipeline file"),
        ("toggles: []", 2, "toggles must be a mapping"),
        ("toggles: {}", 2, "at least one"),
        ("toggles:\n  second: off", 3, "key `off`, not 'off'"),
        ("toggles:\n  second: {of: toy_term}", 3, "key `off`, not of"),
        ("toggles:\n  second: {off: 3}", 3, "must be a component, not 3"),
        ("toggles:\n  secnd:", 3, "did you mean 'second'"),
        ("toggles:\n  second: {off: {use: toy_trm}}", 3, "did you mean 'toy_term'"),
        ("toggles:\n  initializer: {off: {use: toy_points, cont: 1}}", 3, "did you mean 'count'"),
        ("vary:\n  opacity.factor: 3", 3, "list or named alternatives"),
        ("vary:\n  opacity.factor: []", 3, "no values"),
        ("vary:\n  opacity.factor:\n    - 0.5\n    - 0.5", 5, "0.5 twice"),
        ("vary:\n  opacity.factr: [0.5]", 3, "did you mean 'factor'"),
        ("vary:\n  x: {a: 3}", 3, "must map settings to values"),
        ("vary:\n  x: {a: {}, b: {}}", 3, "no alternative of x changes anything"),
        ("vary:\n  x:\n    a: {opacity.: 3}", 4, "must look like"),
        ("vary:\n  x:\n    a: {training.seed: 3}", 4, "seed cannot be varied"),
        ('vary:\n  opacity.value: ["${NO_SUCH_THING}"]', 3, "NO_SUCH_THING"),
        ("toggles: {second: }\nscenes: fern", 3, "scenes must be a list"),
        ("toggles: {second: }\nscenes: []", 3, "scenes must be a list of at least one"),
        ("toggles: {second: }\nscenes: [[a]]", 3, "a name, a path or a loader"),
        ("toggles: {second: }\nscenes:\n  - use: no_loader", 4, "no_loader"),
        ("toggles: {second: }\nseeds: 1.5", 3, "1 or more, not 1.5"),
        ("toggles: {second: }\nseeds: true", 3, "1 or more, not True"),
    ],
)
def test_errors_name_the_line(
    toys: Plugins, tmp_path: Path, text: str, line: int, message: str
) -> None:
    path = write(tmp_path, f"{text}\n")
    with pytest.raises(ExplainedError) as caught:
        plan(path, toys)
    assert message in str(caught.value)
    assert f"ablation.yaml:{line}" in caught.value.where


def test_the_pipeline_must_be_named_and_exist(toys: Plugins, tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("seeds: 2\n")
    with pytest.raises(PipelineError, match="names no pipeline"):
        plan(path, toys)
    path.write_text("pipeline: none.yaml\n")
    with pytest.raises(PipelineError, match="cannot be read") as caught:
        plan(path, toys)
    assert str(tmp_path / "none.yaml") in caught.value.where


def test_only_an_ablation_file_takes_another_pipeline(toys: Plugins, tmp_path: Path) -> None:
    path = write(tmp_path, "toggles: {second: }\n")
    other = tmp_path / "other.yaml"
    other.write_text((tmp_path / "toy.yaml").read_text().replace("name: toy", "name: other"))
    made = make_plan(read_description(path, other), toys)
    assert {run.pipeline.name for run in made.runs} == {"other"}
    with pytest.raises(PipelineError, match="--pipeline needs an ablation file"):
        read_description(other, path)


@pytest.mark.parametrize(
    ("file", "pipeline"),
    [(file, None) for file in FILES]
    + [(file, PIPELINES / "stereogs.yaml") for file in FULL_LENGTH],
    ids=lambda path: path.stem if path else "own",
)
def test_the_ablation_files_of_the_project_are_valid(
    monkeypatch: pytest.MonkeyPatch, file: Path, pipeline: Path | None
) -> None:
    monkeypatch.delenv(SELECTION)
    monkeypatch.setenv("STEREOGS_DATA", "data")
    monkeypatch.setenv("STEREOGS_MODELS", "models")
    made = make_plan(read_description(file, pipeline), Plugins())
    assert len(made.combinations) == COUNTS[file.stem]


def test_the_example_in_the_docs_is_valid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("STEREOGS_DATA", "STEREOGS_MODELS"):
        monkeypatch.setenv(name, "folder")
    monkeypatch.delenv(SELECTION)
    page = (PIPELINES.parent / "docs" / "ablation.md").read_text("utf-8")
    (tmp_path / "example.yaml").write_text(page.partition("```yaml\n")[2].partition("```")[0])
    written = read_description(tmp_path / "example.yaml", PIPELINES / "stereogs_weightfree.yaml")
    assert written.seeds == 3
    # The term and the initializer, each on and off; the values of the decay and the models.
    assert make_plan(replace(written, seeds=1), Plugins()).size == (
        "16 combinations x 3 scenes x 1 seed = 48 runs"
    )


def test_the_counts_cover_all_ablation_files() -> None:
    assert [file.stem for file in FILES] == sorted(COUNTS)


@pytest.mark.parametrize("name", ["multi_view_models", "stereo_models"])
def test_a_missing_model_folder_names_the_variable(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.delenv(SELECTION)
    monkeypatch.setenv("STEREOGS_DATA", "data")
    monkeypatch.delenv("STEREOGS_MODELS", raising=False)
    with pytest.raises(PipelineError, match="'STEREOGS_MODELS' is not set") as caught:
        make_plan(read_description(PIPELINES / "ablations" / f"{name}.yaml"), Plugins())
    assert "stereogs.yaml:" in caught.value.where
