"""`stereogs explain` says what runs when, what it reads and needs, and what is known to go wrong."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from registry import HostDefaults, Percent
from registry.priors import (
    GaussiansPrior,
    MaskPrior,
    MatchingPrior,
    MonocularDepthPrior,
    MultiViewDepthPrior,
    NormalPrior,
    OpticalFlowPrior,
    StereoPrior,
)
from stereogs import Pipeline, build_pipeline
from stereogs.verbs.components.explain import _size, explained, memory
from stereogs.verbs.components.summaries import summary
from tests.host import (
    PIPELINE_POINTS,
    SELECTION,
    STAGES,
    Plugins,
    faults,
    load_pipeline,
    needs,
    parse_pipeline,
    pipeline_item,
    row_count,
)
from tests.registry.toy_plugin import ToyGrowth

ROOT = Path(__file__).parents[3]
TEXT = """\
name: small
scene: {use: toy_scene, path: PATH}
initializer: toy_points
priors: [toy_prior]
regularizers:
  - {use: toy_term, start: 3, every: 3}
  - {use: toy_term, name: once, start: 7, stop: 8, every: 7}
  - {use: toy_term, name: late, start: 20}
  - {use: toy_term, name: nothing, weight: 0}
training: {iterations: 10, sh_degree: 2, max_gaussians: 1000, fields: 2}
"""


def toy_pipeline(toys: Plugins, path: Path) -> Pipeline:
    return parse_pipeline(TEXT.replace("PATH", str(path)), toys, source="small.yaml")


def test_every_section_has_a_stage() -> None:
    assert all(point.stage in range(len(STAGES)) and point.reads for point in PIPELINE_POINTS)
    assert {point.stage for point in PIPELINE_POINTS} == set(range(len(STAGES)))


def test_what_runs_when(toys: Plugins, tmp_path: Path) -> None:
    stages = dict(explained(toy_pipeline(toys, tmp_path)))
    assert list(stages) == ["before training", "in an iteration, for the loss"]
    whens = {one.name: dict(one.notes)["when"] for one in stages["in an iteration, for the loss"]}
    assert whens == {
        "regularizers.toy_term": "iteration 3, 6, 9",
        "regularizers.once": "iteration 7",
        "regularizers.late": "never in 10 iterations",
        "regularizers.nothing": "never in 10 iterations",
    }


def test_many_iterations_are_counted(toys: Plugins, tmp_path: Path) -> None:
    text = TEXT.replace("PATH", str(tmp_path)).replace("iterations: 10", "iterations: 100")
    (_, losses) = dict(explained(parse_pipeline(text, toys))).values()
    assert dict(losses[0].notes)["when"] == "iterations 3, 6 to 99, 33 times"


def test_files_are_looked_for(toys: Plugins, tmp_path: Path) -> None:
    file = tmp_path / "scene.bin"
    file.write_bytes(bytes(1_500_000))
    for path, said in ((tmp_path, "a folder"), (file, "1.5 MB"), (tmp_path / "no", "not exist")):
        scene = dict(explained(toy_pipeline(toys, path)))["before training"][0]
        assert said in dict(scene.notes)["file"]
    missing = faults(toy_pipeline(toys, tmp_path / "no"))
    assert missing[0] == f"scene.toy_scene: {tmp_path / 'no'} does not exist"


def test_a_missing_network_is_a_fault_that_says_where_to_get_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(SELECTION)
    text = "name: n\nscene: procedural\ninitializer: sfm\npriors: [{use: onnx_flow, model: none.onnx}]\n"
    (fault, *_) = faults(parse_pipeline(text, Plugins()))
    assert fault == "priors.onnx_flow: none.onnx does not exist; see `stereogs models`"


def test_what_is_never_due_is_a_fault(toys: Plugins, tmp_path: Path) -> None:
    assert faults(toy_pipeline(toys, tmp_path)) == [
        "regularizers.late: is never due in 10 iterations (small.yaml:8)",
        "regularizers.nothing: is never due in 10 iterations (small.yaml:9)",
    ]


def test_what_is_called_far_too_often_is_a_fault(
    toys: Plugins, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ToyGrowth, "host_defaults", HostDefaults(stop=Percent(50), every=100))

    def fault(written: str) -> list[str]:
        text = f"name: t\nscene: toy_scene\ninitializer: toy_points\ndensification: {written}\n"
        pipeline = parse_pipeline(text, toys, overrides=["training.iterations=1000"])
        return [fault for fault in faults(pipeline) if "called" in fault]

    assert fault("toy_growth") == fault("{use: toy_growth, every: 10, stop: 90%}") == []
    (found,) = fault("{use: toy_growth, start: 1, every: 1, stop: null}")
    assert "is called 1000 times in 1000 iterations, but 5 times by its default schedule" in found
    assert "remove its `start`, `stop`, `every`" in found


SHIPPED = [*(ROOT / "pipelines").glob("*.yaml"), *(ROOT / "pipelines/methods").glob("*.yaml")]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_no_shipped_schedule_is_a_fault(
    shipped: Plugins, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEREOGS_MODELS", "nowhere")
    pipeline = load_pipeline(path, shipped)
    for one in (pipeline, pipeline.scaled(30), pipeline.scaled(3000), pipeline.for_views(24)):
        assert not [fault for fault in faults(one) if "is called" in fault]


def test_memory_counts_four_arrays_of_each_field(toys: Plugins, tmp_path: Path) -> None:
    each = 2 * 4 * 4 * row_count(2)
    text = memory(toy_pipeline(toys, tmp_path))
    assert text.startswith(f"{each} bytes a Gaussian")
    assert f"{each / 1000:.0f} MB for 1,000, the limit of growth" in text


@pytest.fixture
def shipped(monkeypatch: pytest.MonkeyPatch) -> Plugins:
    monkeypatch.delenv(SELECTION)
    monkeypatch.setenv("STEREOGS_DATA", "nowhere")
    return Plugins()


def test_a_prior_that_is_needed_is_looked_for(shipped: Plugins) -> None:
    path = ROOT / "pipelines" / "weightfree.yaml"
    assert not [fault for fault in faults(load_pipeline(path, shipped)) if "prior" in fault]
    without = faults(load_pipeline(path, shipped, disabled=["plane_sweep", "patch_match"]))
    assert [fault for fault in without if MultiViewDepthPrior.capability in fault]


def test_what_shipped_components_need_is_a_capability(shipped: Plugins) -> None:
    bases = (
        *(StereoPrior, MultiViewDepthPrior, MonocularDepthPrior),
        *(OpticalFlowPrior, MatchingPrior, GaussiansPrior, NormalPrior, MaskPrior),
    )
    known = {prior.capability for prior in bases}
    needed = [
        name for offer in shipped.all() for wanted in needs(offer.component) for name in wanted
    ]
    assert len(needed) >= 2
    assert set(needed) <= known


def test_the_command_says_it_and_fails_at_a_fault(
    shipped: Plugins, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from tests.host import main

    path = str(ROOT / "pipelines" / "demo.yaml")
    assert main(["explain", path, "--disable", "ply"]) == 0
    said = capsys.readouterr().out
    assert "iterations 100, 200 to 400, 4 times" in said
    assert "exporters.ply" not in said
    assert "max_reprojection_error: 2.0" in said
    assert main(["explain", path, "--set", "modifiers.dropout.start=601"]) == 1
    assert "fault: modifiers.dropout: is never due in 600 iterations" in capsys.readouterr().out


def test_a_docstring_that_only_names_the_component_is_no_summary(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `stereogs new-plugin` writes it."""
    text = '"""Metric `named_only`."""\nimport registry\nclass Named(registry.Metric):\n    """How far."""\n'
    (tmp_path / "named_only.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    kind = importlib.import_module("named_only").Named
    item = pipeline_item(kind, kind.Settings(), "named_only")
    assert summary(item.offer) == "How far."


def test_paths_in_the_home_folder_exist(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("STEREOGS_PLUGINS", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "fern").mkdir()
    scene = {"use": "llff", "path": "~/fern"}
    pipeline = build_pipeline({"name": "home", "scene": scene, "initializer": "sfm"})
    assert not any("does not exist" in fault for fault in faults(pipeline))
    assert _size(Path("~/fern")) == "a folder"


def test_outputs_on_request_and_who_asked(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from tests.host import main

    monkeypatch.delenv(SELECTION, raising=False)
    path = tmp_path / "p.yaml"
    path.write_text(
        "name: p\nscene: procedural\ninitializer: sfm\nregularizers: [normal_consistency]\n"
        "densification: {use: gradient_threshold, absolute_threshold: 0.0004, start: 20, stop: 40, "
        "every: 20}\n"
        "training: {iterations: 100, max_gaussians: 500}\n"
    )
    assert main(["explain", str(path)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert (
        "rendered or collected on request normals: regularizers.normal_consistency (iterations 20, 21 to "
        "100, 81 times) screen_gradient: densification.gradient_threshold (iteration 20, 40), "
        "training.max_gaussians absolute_screen_gradient: densification.gradient_threshold (iteration 20, 40)"
    ) in shown
    path.write_text(path.read_text().replace("normal_consistency", "field_agreement"))
    assert main(["explain", str(path)]) == 1
    shown = " ".join(capsys.readouterr().out.split())
    assert "fault: regularizers.field_agreement: it needs 'other_fields', but training has" in shown
