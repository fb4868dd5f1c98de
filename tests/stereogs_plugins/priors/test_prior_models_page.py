"""The page on model files: its pipelines are understood, and its tables are those of the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from stereogs_plugins.priors import onnx_mono, onnx_mvs
from stereogs_plugins.priors.onnx_stereo import families as stereo_families
from tests.host import Plugins, parse_pipeline

PAGE = Path(__file__).parents[3] / "docs" / "prior_models.md"
TEXT = PAGE.read_text("utf-8")
NAMES = (
    "onnx_stereo",
    "onnx_mvs",
    "onnx_mono",
    "onnx_moge",
    "onnx_posed",
    "onnx_gaussians",
    "onnx_matching",
    "onnx_flow",
    "torch_module",
)
HEAD = "name: example\nscene: {use: llff, path: fern, train_views: 3}\n"
EXAMPLES = re.findall(r"^```yaml\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def plugins() -> Plugins:
    return Plugins()


@pytest.mark.parametrize("example", EXAMPLES)
def test_its_pipelines_are_understood(
    plugins: Plugins, example: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The preferred prior is chosen where its model file exists."""
    monkeypatch.setenv("STEREOGS_MODELS", str(tmp_path))
    for name in re.findall(r"\$\{STEREOGS_MODELS\}/([\w./]+)", example):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    rest = HEAD if "initializer:" in example else f"{HEAD}initializer: sfm\n"
    pipeline = parse_pipeline(rest + example, plugins, source=PAGE.name)
    networks = [prior for prior in pipeline.items["priors"] if prior.offer.name in NAMES]
    assert len(networks) == 1


def test_there_is_an_example_of_each_prior() -> None:
    assert sorted(set(re.findall(r"use: (onnx_\w+|torch_module)", TEXT))) == sorted(NAMES)


def row(name: str) -> str:
    (found,) = re.findall(rf"^\| `{name}` \| .*$", TEXT.partition("## Naming a file")[2], re.M)[:1]
    return str(found)


@pytest.mark.parametrize("name", list(stereo_families.FAMILIES))
def test_stereo_families_are_described_as_they_are(name: stereo_families.FamilyName) -> None:
    family, text = stereo_families.FAMILIES[name], row(name)
    assert family.value_range in text
    assert f"`{family.output}`" in text or family.output is None
    assert ("negated" in text) == family.negated
    if family.max_disparity is not None and name != "fast_foundation_stereo":
        assert text.endswith(f"| {family.max_disparity:g} |")
    for confidence in family.confidences:
        assert f"`{confidence}`" in TEXT


def test_other_families_are_described_as_they_are() -> None:
    for name, mvs in onnx_mvs.FAMILIES.items():
        assert f"`{mvs.images}`" in row(name)
        assert f"multiples of {mvs.multiple} " in row(name)
        assert f"| `{name}` | `{mvs.depth}` | `{mvs.confidence}` |" in TEXT
    for other, mono in onnx_mono.FAMILIES.items():
        assert f"| {mono.short_side} | {mono.multiple} |" in row(other)
