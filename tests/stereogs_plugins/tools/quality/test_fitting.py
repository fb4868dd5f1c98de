"""The length for a number of seconds on a simulated machine, and the choice of a pipeline."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

import registry.runs.run as runs
import stereogs_plugins.tools.quality.rehearsal as rehearsal
from core_rasterizer import Device
from registry import RunError
from registry.pipeline.pipeline import Pipeline, parse_pipeline
from registry.plugins.discovery import Plugins
from registry.runs.evaluation import evaluate
from registry.runs.options import Fit, InitialState, RunOptions
from registry.runs.run import Run
from registry.runs.training_run import start
from registry.training.field import Field
from stereogs_plugins.tools.quality.fitting import LEAST_ITERATIONS, Budget, choose, fit_length
from stereogs_plugins.tools.quality.table import (
    LONG,
    QUALITIES,
    QUICK,
    QUICK_TIMES,
    SHORT,
    SHORT_TIMES,
    by_length,
    by_quality,
)

TEXT = """\
name: {name}
scene: {{use: toy_scene, path: here, colors: [0, 0, 0]}}
initializer: toy_points
regularizers: [toy_term]
modifiers: [toy_dropout]
densification: {{use: toy_growth, start: 25%, every: 25%, stop: 70%}}
metrics: [psnr]
exporters: [toy_files]
training: {{iterations: {iterations}, sh_degree: 0, max_gaussians: 90}}
"""


class Machine:
    """A simulated clock: scored views and iterations advance it, in proportion to the Gaussians."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, slow: float = 1.0) -> None:
        self.now, self.slow = 100.0, slow
        step = Field.step_optimizer

        def stepped(field: Field) -> None:
            self.now += slow * (0.05 + 1e-4 * field.model.count)
            step(field)

        def evaluated(model, scene, views, metrics, pictures=None):  # type: ignore[no-untyped-def]
            views = list(views)
            self.now += slow * 0.3 * len(views)
            return evaluate(model, scene, views, metrics, pictures)

        monkeypatch.setattr(Field, "step_optimizer", stepped)
        monkeypatch.setattr(rehearsal, "evaluate", evaluated)
        monkeypatch.setattr(runs, "evaluate", evaluated)

    def budget(self, seconds: float) -> Budget:
        return Budget(seconds, self.now, lambda: self.now)


def pipeline(toys: Plugins, name: str = SHORT, iterations: int | str = 400) -> Pipeline:
    return parse_pipeline(TEXT.format(name=name, iterations=iterations), toys)


def trained(first: Pipeline, device: Device, out: Path, fit: Fit | None = None) -> Run:
    return start(first, RunOptions(device=device, progress=False, fit=fit), out)


@pytest.mark.parametrize(("seconds", "slow"), [(8.0, 1.0), (16.0, 2.0)])
def test_a_run_takes_its_seconds_and_can_be_repeated(
    toys: Plugins,
    device: Device,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    seconds: float,
    slow: float,
) -> None:
    machine, said = Machine(monkeypatch, slow=slow), list[str]()
    budget = machine.budget(seconds)
    fit = partial(fit_length, budget=budget, log=said.append)
    run = trained(pipeline(toys), device, tmp_path / "run", fit)
    assert LEAST_ITERATIONS < run.iteration < 400
    assert budget.spent == pytest.approx(seconds, rel=0.1)
    assert f"{SHORT}, {run.iteration} iterations" in said[0]
    expected = float(said[-1].rpartition("= ")[2].removesuffix(" s"))
    assert expected == pytest.approx(seconds, abs=0.2)
    written = (tmp_path / "run" / "pipeline.yaml").read_text("utf-8")
    assert f"iterations: {run.iteration}\n" in written
    again = trained(parse_pipeline(written, toys), device, tmp_path / "again")
    assert again.hash == run.hash


def test_the_length_never_exceeds_that_of_the_pipeline(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine, said = Machine(monkeypatch), list[str]()
    fit = partial(fit_length, budget=machine.budget(60), log=said.append)
    assert trained(pipeline(toys, iterations=30), device, tmp_path / "run", fit).iteration == 30
    assert "less than 60 s" in said[-1]


def test_too_few_seconds_leave_nothing_behind(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit = partial(fit_length, budget=Machine(monkeypatch).budget(3), log=print)
    with pytest.raises(RunError, match="3 s are too few"):
        trained(pipeline(toys), device, tmp_path / "run", fit)
    assert not (tmp_path / "run").exists()


def chosen(
    toys: Plugins,
    device: Device,
    wanted: object,
    said: Callable[[str], None] = print,
    *,
    own: int | str = 400,
    quick: int | str = 160,
) -> Pipeline:
    """Return the chosen pipeline for the toy scene."""

    class Chosen(Exception):
        pass

    def load(name: str) -> Pipeline:
        assert name != SHORT, "it is at hand"
        return pipeline(toys, name, {QUICK: quick, LONG: 2000}[name])

    found: list[Pipeline] = []

    def fit(initial: InitialState) -> Pipeline:
        found.append(choose(initial, wanted, load, said))  # type: ignore[arg-type]
        raise Chosen

    with pytest.raises(Chosen):
        trained(pipeline(toys, iterations=own), device, Path("nowhere"), fit)
    return found[0]


@pytest.mark.parametrize(
    ("quality", "name", "iterations"),
    [("fast", QUICK, 160), ("good", SHORT, 400), ("best", LONG, 2000)],
)
def test_a_quality_is_a_pipeline_and_a_length(
    toys: Plugins, device: Device, quality: str, name: str, iterations: int
) -> None:
    said: list[str] = []
    found = chosen(toys, device, quality, said.append)
    assert (found.name, found.training.iterations) == (name, iterations)
    assert found.items["densification"][0].host.every == iterations // 4
    assert "2 training views of" in said[1]
    assert max(map(len, said)) <= 80


@pytest.mark.parametrize(
    ("seconds", "name"), [(12.0, QUICK), (30.0, SHORT), (100.0, LONG), (600.0, LONG)]
)
def test_seconds_choose_among_the_three_pipelines(
    toys: Plugins,
    device: Device,
    monkeypatch: pytest.MonkeyPatch,
    seconds: float,
    name: str,
) -> None:
    found = chosen(toys, device, Machine(monkeypatch).budget(seconds))
    assert found.name == name
    most = {QUICK: QUICK_TIMES * 160, SHORT: SHORT_TIMES * 400, LONG: 2000}[name]
    assert LEAST_ITERATIONS <= found.training.iterations <= most
    assert found.training.max_gaussians is not None


def test_the_length_depends_on_the_number_of_views(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    """The toy scene has two training views."""
    run = trained(pipeline(toys, iterations="4 per view"), device, tmp_path / "run")
    assert run.iteration == 8
    written = run.folder_or_refuse().pipeline.read_text("utf-8")
    assert "  iterations: 8\n" in written
    again = trained(parse_pipeline(written, toys), device, tmp_path / "again")
    assert again.hash == run.hash


def test_the_chosen_pipeline_has_the_length_for_the_scene(toys: Plugins, device: Device) -> None:
    assert chosen(toys, device, "good", own="150 per view").training.iterations == 300
    assert chosen(toys, device, "fast", quick="30 per view").training.iterations == 60


def test_the_length_chooses_among_the_three_pipelines() -> None:
    assert [by_length(times).name for times in (0.5, 0.7, 1.7, 1.8)] == [QUICK, SHORT, SHORT, LONG]
    for quality in QUALITIES:
        assert len(f"  because {by_quality(quality).reason}") <= 80
