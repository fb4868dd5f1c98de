"""Priors with `fallbacks`: the first whose files exist is used, and the run says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from registry.pipeline.pipeline import Item, load_pipeline, parse_pipeline
from tests.host import SELECTION, PipelineError, Plugins

METHODS = Path(__file__).parents[3] / "pipelines" / "methods"
TEXT = """\
name: small
scene: {{use: llff, path: data}}
initializer: random
priors:
  - use: onnx_mono
    name: monocular
    model: {preferred}
    fallbacks:
      - use: onnx_mono
        family: dpt
        model: {second}
      - depth_cues
"""


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(SELECTION, raising=False)
    monkeypatch.delenv("STEREOGS_MODELS", raising=False)
    monkeypatch.setenv("STEREOGS_DATA", "data")


def prior(preferred: Path | str, second: Path | str, *overrides: str) -> Item:
    text = TEXT.format(preferred=preferred, second=second)
    (item,) = parse_pipeline(text, Plugins(), overrides=overrides).items["priors"]
    return item


def test_a_prior_with_its_file_has_no_fallback(tmp_path: Path) -> None:
    (tmp_path / "a.onnx").touch()
    item = prior(tmp_path / "a.onnx", tmp_path / "b.onnx")
    assert (item.name, item.host.use, item.fallback) == ("monocular", "onnx_mono", "")


def test_the_first_complete_fallback_keeps_the_name(tmp_path: Path) -> None:
    (tmp_path / "b.onnx").touch()
    item = prior(tmp_path / "a.onnx", tmp_path / "b.onnx")
    assert item.name == "monocular"
    assert item.settings.model_dump()["family"] == "dpt"
    missing = f"{tmp_path / 'a.onnx'} does not exist"
    assert item.fallback == f"monocular is onnx_mono with b.onnx: {missing}"


def test_an_unset_variable_counts_as_a_missing_file() -> None:
    item = prior("${STEREOGS_MODELS}/a.onnx", "${STEREOGS_MODELS}/b.onnx")
    assert item.host.use == "depth_cues"
    unset = "the environment variable 'STEREOGS_MODELS' is not set"
    assert item.fallback == f"monocular is depth_cues: {unset}"


def test_the_written_pipeline_names_the_fallback_alone(tmp_path: Path) -> None:
    text = TEXT.format(preferred=tmp_path / "a.onnx", second=tmp_path / "b.onnx")
    pipeline = parse_pipeline(text, Plugins())
    written = pipeline.to_yaml()
    assert "fallbacks" not in written
    assert "a.onnx" not in written
    assert parse_pipeline(written, Plugins()).items == pipeline.items


def test_a_model_from_the_command_line_has_no_fallback(tmp_path: Path) -> None:
    chosen = f"priors.monocular.model={tmp_path / 'mine.onnx'}"
    item = prior(tmp_path / "a.onnx", tmp_path / "b.onnx", chosen)
    assert item.host.use == "onnx_mono"
    assert not item.fallback
    assert item.settings.model_dump()["model"] == tmp_path / "mine.onnx"


def test_a_disabled_prior_is_not_replaced() -> None:
    text = TEXT.format(preferred="${STEREOGS_MODELS}/a.onnx", second="b.onnx")
    assert parse_pipeline(text, Plugins(), disabled=["monocular"]).items["priors"] == ()


def test_fallbacks_must_be_a_list() -> None:
    text = TEXT.format(preferred="a.onnx", second="b.onnx").partition("    fallbacks:")[0]
    with pytest.raises(PipelineError, match="fallbacks is a list of priors, not 'depth_cues'"):
        parse_pipeline(text + "    fallbacks: depth_cues\n", Plugins())


PUBLISHED = ("d2gs", "dngaussian", "fsgs", "mvpgs", "sparsenerf", "d2gs-short", "fsgs-short")


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_methods_need_no_model_file(name: str) -> None:
    priors = load_pipeline(METHODS / f"{name}.yaml", Plugins()).items["priors"]
    assert all(not item.host.use.startswith("onnx") for item in priors)
    assert any(item.fallback for item in priors)
