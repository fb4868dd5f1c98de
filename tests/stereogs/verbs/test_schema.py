"""The schema that editors check pipelines with says what the host says."""

from __future__ import annotations

import json
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import jsonschema
import pydantic
import pytest

import registry
from stereogs.verbs.schema import pipeline_schema
from tests.host import GROUP, Offer, PipelineError, Plugins, main, parse_pipeline, parse_yaml, plain

ROOT = Path(__file__).parents[3]
KEPT = ROOT / "pipelines" / "pipeline.schema.json"
PIPELINES = sorted([*ROOT.glob("pipelines/*.yaml"), *ROOT.glob("pipelines/methods/*.yaml")])
GOOD = """\
name: small
scene: {use: toy_scene, path: somewhere, colors: [0, 0.5, 1]}
initializer: toy_points
regularizers: [{use: toy_term, name: pull, weight: 0.5, stop: 50%, every: 2}]
densification: {use: toy_growth, start: 2}
opacity: [toy_fade, {use: toy_fade, name: again, enabled: false}]
metrics:
training: {iterations: 5, learning_rates: {scale: 0.01}}
"""
BAD = {
    "regularizers=[{use: toy_term, targt: 1}]": "targt",
    "regularizers=[{use: toy_term, target: much}]": "much",
    "regularizers=[toy_trem]": "toy_trem",
    "regularizers=[{use: toy_term, stop: half}]": "half",
    "regularizers=[{use: toy_term, weight: -1}]": "-1",
    "regularizers=toy_term": "toy_term",
    "scene=[toy_scene]": "toy_scene",
    "scene={use: toy_scene, mode: great}": "great",
    "metric=[psnr]": "metric",
    "metrics=[{use: psnr, weight: 2}]": "weight",
    "training.iteration=3": "iteration",
    "training.learning_rates.scale=fast": "fast",
    "name=3": "3",
    "protocol=llff-4": "llff-4",
    "initializer=null": "None",
}


@pytest.fixture(scope="module")
def shipped() -> dict[str, Any]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    written = project["entry-points"][GROUP]
    entries = [EntryPoint(name, module, GROUP) for name, module in written.items()]
    return pipeline_schema(Plugins(entries).all())


def errors(schema: dict[str, Any], pipeline: Any) -> str:
    checker = jsonschema.Draft202012Validator(schema)
    return "\n".join(str(error) for error in checker.iter_errors(pipeline))


def test_it_is_a_schema(shipped: dict[str, Any], toys: Plugins) -> None:
    for schema in (shipped, pipeline_schema(toys.all()), pipeline_schema([])):
        jsonschema.Draft202012Validator.check_schema(schema)


def test_the_schema_of_what_ships_is_up_to_date(shipped: dict[str, Any]) -> None:
    assert json.loads(KEPT.read_text("utf-8")) == shipped, "run `make docs`"


@pytest.mark.parametrize("path", PIPELINES, ids=lambda path: str(path.relative_to(ROOT)))
def test_shipped_pipelines_are_bound_to_it_and_fit(
    path: Path, shipped: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    first = path.read_text("utf-8").splitlines()[0]
    comment, _, schema = first.partition("=")
    assert comment == "# yaml-language-server: $schema"
    assert (path.parent / schema).samefile(KEPT)
    for name in ("STEREOGS_DATA", "STEREOGS_MODELS"):
        monkeypatch.setenv(name, "somewhere")
    assert errors(shipped, plain(parse_yaml(path.read_text("utf-8"), path.name))) == ""


def test_what_the_host_reads_fits(toys: Plugins) -> None:
    parse_pipeline(GOOD, toys)
    assert errors(pipeline_schema(toys.all()), plain(parse_yaml(GOOD, "good"))) == ""


def test_a_pipeline_written_in_full_fits(toys: Plugins) -> None:
    full = parse_pipeline(GOOD, toys).to_yaml()
    assert errors(pipeline_schema(toys.all()), plain(parse_yaml(full, "full"))) == ""


@pytest.mark.parametrize(("change", "told"), BAD.items())
def test_what_the_host_refuses_does_not_fit(change: str, told: str, toys: Plugins) -> None:
    path, _, value = change.partition("=")
    changed = plain(parse_yaml(GOOD, "good"))
    *parents, last = path.split(".")
    inner = changed
    for key in parents:
        inner = inner.setdefault(key, {})
    inner[last] = plain(parse_yaml(value, "change"))
    with pytest.raises((PipelineError, registry.PluginError)):
        parse_pipeline(json.dumps(changed), toys)
    assert told in errors(pipeline_schema(toys.all()), changed)


def test_settings_that_pydantic_cannot_describe_spoil_nothing(toys: Plugins) -> None:
    class Odd(registry.Settings):
        model_config = pydantic.ConfigDict(arbitrary_types_allowed=True)
        value: Plugins | None = None

    class OddMetric(registry.Metric[Odd]):
        """Has such settings."""

        def measure(self, rendered: Any, photograph: Any, mask: Any) -> float:
            return 0.0

    known = toys.all()
    point = next(offer.point for offer in known if offer.point.section == "metrics")
    schema = pipeline_schema([*known, Offer(point, "odd", OddMetric, "odd", "odd", "1")])
    assert "cannot be described" in schema["$defs"]["metrics.odd"]["description"]
    changed = {**plain(parse_yaml(GOOD, "good")), "metrics": ["odd", {"use": "odd", "value": None}]}
    assert errors(schema, changed) == ""


def test_the_command_prints_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == pipeline_schema([])
