from __future__ import annotations

import re
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from core_rasterizer import ExplainedError
from registry import PluginError
from registry.pipeline.pipeline import Pipeline, load_pipeline, parse_pipeline
from tests.host import PipelineError, Plugins

MINIMAL = """\
name: small
scene: toy_scene
initializer: {use: toy_points}
"""
FULL = """\
name: full
scene:
  use: toy_scene
  path: a/b
  colors: [1, 0.5, 1e-3]
initializer: toy_points
priors:
  - toy_prior
regularizers:
  - {use: toy_term, weight: 0.25, start: 10, stop: 20, every: 5}
  - use: toy_term
    name: second
    target: 1
modifiers: [toy_dropout]
densification: {use: toy_growth, every: 100}
opacity:
  use: toy_fade
metrics: [psnr]
exporters: []
training:
  iterations: 50
  learning_rates:
    opacity: 1e-2
"""


def refused(text: str, plugins: Plugins, **changes: list[str]) -> ExplainedError:
    with pytest.raises((PipelineError, PluginError)) as caught:
        parse_pipeline(text, plugins, source="a.yaml", **changes)
    return caught.value


def test_a_minimal_pipeline_has_the_defaults_of_3dgs(toys: Plugins) -> None:
    pipeline = parse_pipeline(MINIMAL, toys)
    assert [item.name for item in pipeline] == ["toy_scene", "toy_points"]
    training = pipeline.training
    assert (training.iterations, training.seed, training.sh_degree) == (30_000, 0, 3)
    assert training.learning_rates.sh_rest == 0.0025 / 20


def test_everything_that_is_written_arrives(toys: Plugins) -> None:
    pipeline = parse_pipeline(FULL, toys, source="a.yaml")
    assert pipeline.one("scene").settings.model_dump()["colors"] == (1, 0.5, 1e-3)
    first, second = pipeline.items["regularizers"]
    assert (first.host.weight, first.schedule.start, first.schedule.stop) == (0.25, 10, 20)
    assert (second.name, second.qualified_name) == ("second", "regularizers.second")
    assert str(second.place) == "a.yaml:11"
    assert pipeline.training.learning_rates.opacity == 0.01


@pytest.mark.parametrize("text", [MINIMAL, FULL])
def test_the_resolved_pipeline_reads_back_the_same(toys: Plugins, text: str) -> None:
    pipeline = parse_pipeline(text, toys)
    again = parse_pipeline(pipeline.to_yaml(), toys)
    assert again == pipeline
    assert again.to_yaml() == pipeline.to_yaml()


def test_a_resolved_path_may_contain_a_dollar_sign(
    toys: Plugins, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ODD", "x/${y}")
    pipeline = parse_pipeline(FULL.replace("a/b", "${ODD}"), toys)
    assert parse_pipeline(pipeline.to_yaml(), toys) == pipeline


@pytest.mark.parametrize(
    ("old", "new", "where", "message"),
    [
        ("path: a/b", "pth: a/b", "a.yaml:4", "scene has no setting 'pth'; did you mean 'path'"),
        ("iterations: 50", "iteration: 5", "a.yaml:21", "did you mean 'iterations'"),
        ("opacity: 1e-2", "opacty: 1", "a.yaml:23", "training.learning_rates has no setting"),
        ("iterations: 50", "iterations: yes", "a.yaml:21", "must be a whole number, not 'yes'"),
        ("iterations: 50", "iterations: true", "a.yaml:21", "must be a whole number, not True"),
        ("iterations: 50", "iterations: 5.5", "a.yaml:21", "must be a whole number, not 5.5"),
        ("iterations: 50", "iterations: '5'", "a.yaml:21", "must be a whole number, not '5'"),
        ("iterations: 50", "iterations: 0", "a.yaml:21", "greater than or equal to 1"),
        ("opacity: 1e-2", "opacity: .nan", "a.yaml:23", "training.learning_rates.opacity"),
        ("path: a/b", "path: 3", "a.yaml:4", "must be text"),
        ("path: a/b", "strict: on", "a.yaml:4", "must be true or false, not 'on'"),
        ("path: a/b", "mode: bad", "a.yaml:4", "'good', 'missing' or 'crash'"),
        ("path: a/b", "nested: 3", "a.yaml:4", "scene.nested must be a mapping"),
        ("[1, 0.5, 1e-3]", "[1, 2]", "a.yaml:5", "scene.colors"),
        ("1, 0.5, 1e-3", "1, 0.5, x", "a.yaml:5", "scene.colors.2 must be a number, not 'x'"),
        ("path: a/b", "start: 3", "a.yaml:4", "scene has no setting 'start'"),
        ("path: a/b", "weight: 3", "a.yaml:4", "scene has no setting 'weight'"),
        ("start: 10", "start: 30", "a.yaml:10", r"stop \(20\) is before start \(30\)"),
        ("weight: 0.25", "weight: -1", "a.yaml:10", "regularizers.toy_term.weight"),
        ("every: 5", "evry: 5", "a.yaml:10", "did you mean 'every'"),
        ("every: 5", "every: 0", "a.yaml:10", "regularizers.toy_term.every"),
        ("name: second", "name: a.b", "a.yaml:12", "regularizers.a.b.name"),
        ("name: second", "target: 1", "a.yaml:13", "written twice"),
        ("    name: second\n", "", "a.yaml:11", "two regularizers are named 'toy_term'"),
        ("use: toy_scene", "uses: toy_scene", "a.yaml:3", "does not say which scene loader"),
        ("use: toy_fade", "use: no", "a.yaml:17", "no plugin offers the opacity policy 'no'"),
        ("use: toy_fade", "use: toy_fad", "a.yaml:17", "did you mean 'toy_fade'"),
        ("use: toy_fade", "use: toy_growth", "a.yaml:17", "there is a densification of that name"),
        ("use: toy_fade", "use: 3", "a.yaml:17", "opacity.use must be text"),
        ("metrics: [psnr]", "metrics: psnr", "a.yaml:18", "metrics must be a list"),
        ("metrics: [psnr]", "metric: [psnr]", "a.yaml:18", "did you mean 'metrics'"),
        ("metrics: [psnr]", "metrics: [[psnr]]", "a.yaml:18", "a name or a mapping"),
        ("initializer: toy_points", "initializer: [toy_points]", "a.yaml:6", "single initializer"),
        ("initializer: toy_points", "initializer:", "a.yaml:6", "has no initializer"),
        ("name: full", "name: 3", "a.yaml:1", "needs a name"),
        ("name: full\n", "", "a.yaml:1", "needs a name"),
    ],
)
def test_mistakes_are_named_with_their_line(
    toys: Plugins, old: str, new: str, where: str, message: str
) -> None:
    assert FULL.count(old) == 1
    error = refused(FULL.replace(old, new), toys)
    assert error.where.split(";")[0] == where
    assert re.search(message, error.what), error.what
    assert error.fix


def test_known_settings_are_listed(toys: Plugins) -> None:
    error = refused(FULL.replace("path: a/b", "pth: a/b"), toys)
    for name in ("path", "test_views", "colors", "use", "name", "enabled"):
        assert name in error.fix


def test_all_mistakes_of_a_component_come_at_once(toys: Plugins) -> None:
    text = FULL.replace("iterations: 50", "iterations: x\n  seeds: 1\n  ssim_weight: 2")
    error = refused(text, toys)
    assert "3 settings are wrong" in error.what
    for place in ("a.yaml:21", "a.yaml:22", "a.yaml:23"):
        assert place in error.what


@pytest.mark.parametrize("text", ["", "[]", "just text", "3"])
def test_a_pipeline_is_a_mapping(toys: Plugins, text: str) -> None:
    assert "a mapping of sections" in refused(text, toys).what


def test_a_disabled_component_may_even_be_unknown(toys: Plugins) -> None:
    text = FULL.replace("use: toy_fade", "use: not_installed\n  enabled: false")
    assert parse_pipeline(text, toys).items["opacity"] == ()


class TestOverrides:
    def changed(self, toys: Plugins, *overrides: str, disabled: tuple[str, ...] = ()) -> Pipeline:
        return parse_pipeline(FULL, toys, overrides=overrides, disabled=disabled)

    def test_values_are_yaml(self, toys: Plugins) -> None:
        pipeline = self.changed(
            toys,
            "training.iterations=7",
            "training.learning_rates.scale=1e-3",
            "scene.colors=[0, 0, 1]",
            "scene.path=x=y",
            "metrics=[]",
            "densification=null",
            "initializer.count=4",
            "name=other",
        )
        assert pipeline.training.iterations == 7
        assert pipeline.training.learning_rates.scale == 1e-3
        assert pipeline.training.learning_rates.opacity == 1e-2
        assert pipeline.one("scene").settings.model_dump()["path"] == Path("x=y")
        assert pipeline.items["metrics"] == pipeline.items["densification"] == ()
        assert pipeline.one("initializer").settings.model_dump(exclude_defaults=True) == {
            "count": 4
        }
        assert pipeline.name == "other"

    def test_items_of_a_list_go_by_name(self, toys: Plugins) -> None:
        pipeline = self.changed(
            toys, "regularizers.second.weight=2", "modifiers.toy_dropout.every=3"
        )
        assert [item.host.weight for item in pipeline.items["regularizers"]] == [0.25, 2]
        assert pipeline.items["modifiers"][0].schedule.every == 3

    @pytest.mark.parametrize(
        ("override", "message"),
        [
            ("training.iteration=3", "did you mean 'iterations'"),
            ("trainig.iterations=3", "no section 'trainig'; did you mean 'training'"),
            ("regularizers.toy_trem.weight=2", "no item 'toy_trem'; did you mean 'toy_term'"),
            ("regularizers.second.wieght=2", "did you mean 'weight'"),
            ("training.iterations.x=3", "has no parts to set"),
            ("training.iterations=[", "not valid YAML"),
            ("training.iterations", "must look like"),
            ("=3", "must look like"),
            ("training..x=3", "must look like"),
            ("training.iterations=many", "must be a whole number, not 'many'"),
            ("scene.use=toy_scen", "did you mean 'toy_scene'"),
            ("scene.path=${NOT_SET_ANYWHERE}", "not set"),
            ('scene.path="${HOME"', "is not closed"),
        ],
    )
    def test_mistakes_name_the_option(self, toys: Plugins, override: str, message: str) -> None:
        error = refused(FULL, toys, overrides=[override])
        assert message in error.what
        assert error.where.split(";")[0] == f"--set {override}"

    def test_an_override_replaces_a_variable_that_is_not_set(self, toys: Plugins) -> None:
        text = FULL.replace("a/b", "${NOT_SET_ANYWHERE}")
        assert "NOT_SET_ANYWHERE" in refused(text, toys).what
        parse_pipeline(text, toys, overrides=["scene.path=here"])

    def test_disable_by_alias_by_use_and_everywhere(self, toys: Plugins) -> None:
        assert not self.changed(toys, disabled=("psnr",)).items["metrics"]
        (left,) = self.changed(toys, disabled=("second",)).items["regularizers"]
        assert left.name == "toy_term"
        assert not self.changed(toys, disabled=("toy_term",)).items["regularizers"]

    @pytest.mark.parametrize(
        ("name", "message"),
        [("toy_trem", "did you mean 'toy_term'"), ("toy_scene", "which a pipeline requires")],
    )
    def test_disable_mistakes(self, toys: Plugins, name: str, message: str) -> None:
        error = refused(FULL, toys, disabled=[name])
        assert message in error.what
        assert error.where == f"--disable {name}"


def test_ready_pipelines_load_with_the_projects_own_plugins(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    root = Path(__file__).parents[3]
    project = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))
    entries = project["project"]["entry-points"]["stereogs.plugins"]
    plugins = Plugins([EntryPoint(n, m, "stereogs.plugins") for n, m in entries.items()])
    monkeypatch.setenv("STEREOGS_DATA", "somewhere")
    monkeypatch.setenv("STEREOGS_MODELS", "somewhere")
    files = sorted((root / "pipelines").glob("*.yaml"))
    assert {"3dgs.yaml", "demo.yaml"} <= {file.name for file in files}
    for file in files:
        load_pipeline(file, plugins)
