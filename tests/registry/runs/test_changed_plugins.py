"""Runs whose plugins have another version or other code now, or are not installed any more."""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib.metadata import distributions
from pathlib import Path

import pytest

from core_rasterizer import Device, ExplainedError
from registry import RunError
from registry.runs.opening import load_run
from registry.runs.options import RunOptions
from registry.runs.outputs import renew
from registry.runs.run import Run
from registry.runs.training_run import continue_run, start_run
from tests.host import (
    GROUP,
    Plugins,
    comparable_groups,
    labels,
    module_digest,
    parse_pipeline,
    read_run,
)
from tests.registry.conftest import TOYS

TEXT = """\
name: with-acme
scene: toy_scene
initializer: toy_points
regularizers: [acme_term]
metrics: [acme_score]
training: {iterations: 6, sh_degree: 0}
"""
MODULE = """
import registry

class Term(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        return FACTOR * step.rendering.alpha.mean()

class Score(registry.Metric[registry.Settings]):
    def measure(self, rendered, photograph, mask):
        return FACTOR

@registry.hookimpl
def stereogs_register_regularizers(register):
    register("acme_term", Term)

@registry.hookimpl
def stereogs_register_metrics(register):
    register("acme_score", Score)
"""


class Acme:
    """The package `acme`, of which one version at a time is installed."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._folder, self._monkeypatch = folder, monkeypatch

    def installed(self, version: str, factor: float) -> Plugins:
        """Install a version in place of the one before."""
        site = self._folder / f"site-{version}-{factor}"
        metadata = site / f"acme-{version}.dist-info"
        metadata.mkdir(parents=True)
        (metadata / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: acme\nVersion: {version}\n"
        )
        (metadata / "entry_points.txt").write_text(f"[{GROUP}]\nacme_term=acme\nacme_score=acme\n")
        (site / "acme.py").write_text(MODULE.replace("FACTOR", str(factor)))
        self._monkeypatch.syspath_prepend(site)
        self._monkeypatch.delitem(sys.modules, "acme", raising=False)
        module_digest.cache_clear()
        (package,) = distributions(path=[str(site)])
        return Plugins([*TOYS, *package.entry_points])


@pytest.fixture
def acme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Acme:
    return Acme(tmp_path, monkeypatch)


def quiet(device: Device) -> RunOptions:
    return RunOptions(device=device, progress=False)


def trained(plugins: Plugins, device: Device, out: Path, *, until: int = 6) -> Run:
    options = replace(quiet(device), callback=lambda done: done.number < until)
    return start_run(parse_pipeline(TEXT, plugins, source="p.yaml"), options, out)


@pytest.mark.parametrize(("version", "factor"), [("2.0", 0.5), ("1.0", 0.25)])
def test_a_run_resumes_with_other_plugins_only_if_they_are_accepted(
    acme: Acme, device: Device, tmp_path: Path, version: str, factor: float
) -> None:
    """Another version, and other code of the same version."""
    out = tmp_path / "run"
    trained(acme.installed("1.0", 0.5), device, out, until=3)
    other = acme.installed(version, factor)
    with pytest.raises(RunError, match="plugins have changed") as caught:
        continue_run(out, quiet(device), other)
    assert f"regularizers.acme_term is now of acme {version}" in caught.value.what
    assert "was of acme 1.0" in caught.value.what
    assert "--accept-changed-plugins" in caught.value.fix
    accepting = replace(quiet(device), accept_changed_plugins=True)
    assert continue_run(out, accepting, other).finished
    assert continue_run(out, quiet(device), other).finished, "the last resumption counts"


def test_eval_refuses_another_metric_and_compare_separates_the_runs(
    acme: Acme, device: Device, tmp_path: Path
) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    trained(acme.installed("1.0", 0.5), device, first)
    other = acme.installed("3.0", 0.75)
    run = load_run(first, plugins=other, device=device, to_train=False)
    with pytest.raises(RunError, match=r"metrics.acme_score is now of acme 3\.0"):
        renew(run, run.folder_or_refuse())
    trained(other, device, second)
    runs = [read_run(path) for path in (first, second)]
    (_, _), (_, reason) = comparable_groups(runs)
    assert "`package` 'acme 1.0, code" in reason
    assert "acme 3.0" in reason
    for label, version in zip(labels(runs), ("1.0", "3.0"), strict=True):
        assert f"packages.regularizers.acme_term=acme {version}" in label
    assert renew(run, run.folder_or_refuse(), accept_changed_plugins=True)["test"] == {
        "acme_score": 0.75
    }
    assert renew(run, run.folder_or_refuse())["packages"]["metrics.acme_score"].startswith(
        "acme 3.0"
    )


def test_a_finished_run_is_used_without_the_plugins_that_trained_it(
    acme: Acme, device: Device, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    before = trained(acme.installed("1.0", 0.5), device, out)
    toys = Plugins(TOYS)
    run = load_run(out, plugins=toys, device=device, to_train=False)
    assert run.hash == before.hash
    assert list(run.pipeline.missing) == ["regularizers.acme_term", "metrics.acme_score"]
    assert run.render(run.scene.test[0].camera).rgb.any()
    with pytest.raises(ExplainedError, match="no plugin offers the metric 'acme_score'") as caught:
        renew(run, run.folder_or_refuse())
    assert "the run was written with" in caught.value.fix
    assert "acme 1.0" in caught.value.fix
    with pytest.raises(ExplainedError, match="no plugin offers the regularizer") as caught:
        continue_run(out, quiet(device), toys)
    assert "the run was written with" in caught.value.fix
    assert "acme 1.0" in caught.value.fix
