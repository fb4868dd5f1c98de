"""The example packages can be installed, discovered and used."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

import stereogs
from tests.host import Plugins, verbs
from tests.packages import ROOT, importable, install, run_python

PACKAGES = sorted(path.parent for path in (ROOT / "docs" / "examples").glob("*/pyproject.toml"))
PIPELINE = """\
name: examples
scene: {use: procedural, width: 48, height: 36}
initializer: {use: flat, points_per_view: 200}
priors:
  - {use: script_normals, model: MODELS/flat.pt}
  - {use: script_metric, model: MODELS/metric.pt}
regularizers:
  - {use: robust_normals, weight: 0.1}
  - {use: pearson_depth, prior: script_metric}
opacity: {use: idle_fade, patience: 2}
densification: {use: gradient_threshold, start: 2, every: 3}
training: {iterations: 8, sh_degree: 0}
"""
NETWORKS = {
    "flat.pt": lambda image: image * 0 - 1,
    "metric.pt": lambda image: (2 - image.mean(1), image.new_ones(1), 1 + image.mean(1)),
}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return install(PACKAGES, tmp_path_factory.mktemp("examples"))


def test_there_is_one_of_each_kind_that_the_tutorial_links_to() -> None:
    page = (ROOT / "docs" / "write_a_plugin.md").read_text("utf-8")
    assert all(f"(examples/{package.name})" in page for package in PACKAGES)


@pytest.fixture
def installed(site: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Plugins]:
    """The plugins that ship, and the examples."""
    with importable(site, monkeypatch) as plugins:
        yield plugins


def test_they_are_found_through_their_entry_points(installed: Plugins) -> None:
    offers = {offer.name: offer for offer in installed.all()}
    for package in PACKAGES:
        project = tomllib.loads((package / "pyproject.toml").read_text("utf-8"))["project"]
        for name in project["entry-points"].get("stereogs.plugins", ()):
            found = (offers[name].distribution, offers[name].version)
            assert found == (project["name"], project["version"])


def test_the_verb_of_one_is_found(installed: Plugins) -> None:
    assert verbs()["largest"].owner == "stereogs-largest-command 0.1.0"
    assert verbs()["largest"].summary == "list the largest Gaussians of a run"


@pytest.mark.proof
def test_their_own_tests_pass(site: Path, tmp_path: Path) -> None:
    tests = [str(file) for package in PACKAGES for file in package.glob("test_*.py")]
    assert len(tests) == len(PACKAGES)
    options = ("-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path), "-c", "/dev/null")
    run_python("-m", "pytest", *options, *tests, folder=tmp_path, site=site)


@pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")
def test_a_pipeline_of_them_trains(installed: Plugins, tmp_path: Path) -> None:
    for name, network in NETWORKS.items():
        torch.jit.trace(network, torch.zeros(1, 3, 2, 2)).save(str(tmp_path / name))
    text = PIPELINE.replace("MODELS", str(tmp_path))
    pipeline = stereogs.build_pipeline(text, plugins=installed)
    run = stereogs.train(pipeline, out=tmp_path / "run", progress=False)
    assert run.finished
    provenance = json.loads((tmp_path / "run" / "provenance.json").read_text("utf-8"))
    plugin = provenance["plugins"]["opacity.idle_fade"]
    assert plugin.startswith("stereogs-idle-opacity 0.1.0, code ")
    assert "fading" in run.metrics[-1]
    assert run.metrics[-1]["regularizers.robust_normals"] > 0
    assert run.metrics[-1]["regularizers.pearson_depth"] > 0
