"""The length for a number of seconds on a simulated machine, and the choice of a pipeline."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import stereogs.quality.rehearsal as rehearsal
from core_rasterizer import Device
from registry import Scene
from stereogs import Pipeline, Run, RunOptions
from stereogs.quality.fitting import HURRIED, Fit, WithQuality
from stereogs.quality.table import (
    BEST,
    LONG,
    LONG_TIMES,
    MANY,
    QUALITIES,
    QUICK,
    QUICK_TIMES,
    SHORT,
    SHORT_TIMES,
    Quality,
    by_length,
    by_quality,
)
from stereogs.quality.within_seconds import (
    FEW_ITERATIONS,
    MIN_ITERATIONS,
    Budget,
    WithinSeconds,
)
from tests.host import Field, Plugins, Prepared, evaluate, parse_pipeline, start_run

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
            self.now += self.slow * (0.05 + 1e-4 * field.model.count)
            step(field)

        def evaluated(model, scene, views, *given, **options):  # type: ignore[no-untyped-def]
            views = list(views)
            self.now += self.slow * 0.3 * len(views)
            return evaluate(model, scene, views, *given, **options)

        monkeypatch.setattr(Field, "step_optimizer", stepped)
        monkeypatch.setattr(rehearsal, "evaluate", evaluated)
        monkeypatch.setattr("registry.runs.trained_scene.evaluate", evaluated)

    def budget(self, seconds: float) -> Budget:
        return Budget(seconds, self.now, lambda: self.now)


def pipeline(toys: Plugins, name: str = SHORT, iterations: int | str = 400) -> Pipeline:
    return parse_pipeline(TEXT.format(name=name, iterations=iterations), toys)


def trained(first: Pipeline, device: Device, out: Path, fit: Fit | None = None) -> Run:
    train = start_run if fit is None else fit.train
    return train(first, RunOptions(device=device, progress=False), out)


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
    fit = WithinSeconds(said.append, budget=budget)
    run = trained(pipeline(toys), device, tmp_path / "run", fit)
    assert MIN_ITERATIONS < run.iteration < 400
    assert ("hurried" in run.initialization) == (run.iteration < FEW_ITERATIONS)
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
    fit = WithinSeconds(said.append, budget=machine.budget(60))
    assert trained(pipeline(toys, iterations=30), device, tmp_path / "run", fit).iteration == 30
    assert "less than 60 s" in said[-1]


def test_too_few_seconds_train_the_least_and_end_late(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = list[str]()
    fit = WithinSeconds(said.append, budget=Machine(monkeypatch).budget(3))
    run = trained(pipeline(toys), device, tmp_path / "run", fit)
    assert (run.iteration, run.finished) == (MIN_ITERATIONS, True)
    first, *reasons = fit.closing(run)
    took, _, wanted = first.removeprefix("late      took ").partition(" s instead of ")
    assert wanted == "3 s, because"
    assert float(took) > 3
    assert f"{MIN_ITERATIONS} iterations took" in reasons[2]
    hurried = run.folder_or_refuse().results()["initialization"]["hurried"]
    assert hurried.startswith("hurried: --seconds 3 left time for ")
    assert f"and {MIN_ITERATIONS} iterations; without --seconds" in hurried
    assert hurried in reasons
    assert max(map(len, said)) <= 80


def test_no_time_left_measures_nothing(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine, said = Machine(monkeypatch), list[str]()
    budget = machine.budget(3)
    machine.now += 5
    run = trained(
        pipeline(toys), device, tmp_path / "run", WithinSeconds(said.append, budget=budget)
    )
    assert run.iteration == MIN_ITERATIONS
    assert said[-1] == "  5.0 s have passed, so the run takes longer than 3 s"


def test_training_starts_again_if_the_machine_becomes_slow(
    toys: Plugins, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine, said = Machine(monkeypatch), list[str]()

    class Slowed(WithinSeconds):
        def fitted(self, initial: Prepared) -> Pipeline:
            found = super().fitted(initial)
            machine.slow = 2.0
            return found

    budget = machine.budget(12)
    out = tmp_path / "run"
    fit = Slowed(said.append, budget=budget)
    run = trained(pipeline(toys), device, out, fit)
    pace, choice = said[-2:]
    assert pace.endswith("times as long as measured; training starts again")
    assert float(pace.split()[2]) == pytest.approx(2, abs=0.2)
    planned = int(choice.rpartition("instead of ")[2])
    assert choice == f"  with {run.iteration} iterations instead of {planned}"
    assert MIN_ITERATIONS < run.iteration < planned / 2
    assert run.finished
    assert budget.spent == pytest.approx(12, rel=0.15)
    fit.budget = replace(budget, seconds=1)  # so that it reports where the time went
    assert any("training before it started again took" in line for line in fit.closing(run))
    lines = (out / "metrics.jsonl").read_text("utf-8").splitlines()
    assert len(lines) == len(run.metrics), "those of the first start are gone"
    again = trained(
        parse_pipeline((out / "pipeline.yaml").read_text("utf-8"), toys), device, tmp_path / "again"
    )
    assert (again.iteration, again.hash) == (run.iteration, run.hash)


def test_a_loader_is_hastened_unless_its_setting_is_given(
    toys: Plugins, device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def within(settings: Any, cpu_seconds: float) -> Any:
        asked.append(cpu_seconds)
        return settings.model_copy(update={"colors": (1.0, 0.0, 0.0), "path": Path("there")})

    def load(name: str) -> Pipeline:
        return pipeline(toys, name)

    first, asked, said, machine = pipeline(toys), list[float](), list[str](), Machine(monkeypatch)
    monkeypatch.setattr(first.one("scene").offer.component, "within", within)
    machine.now += 1.0
    budget = machine.budget(9.0)
    fit = WithinSeconds(said.append, kept={"scene.path"}, budget=budget, load=load)
    machine.now += 1.0
    run = trained(first, device, tmp_path / "run", fit)
    told = "colors: (1.0, 0.0, 0.0) instead of (0.0, 0.0, 0.0)"
    assert said[0] == f"{told}: time is short"
    assert 0 < asked[0] <= 4.0 * (os.cpu_count() or 1)
    assert f"iterations, {told}; for a better scene: stereogs train here" in str(
        run.initialization[HURRIED]
    )


def test_ctrl_c_ends_a_training_that_would_start_again(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    class Again(Fit):
        def corrected(self, done: int, total: int) -> Pipeline | None:
            signal.raise_signal(signal.SIGINT)
            return pipeline(toys)

    run = trained(pipeline(toys), device, tmp_path / "run", Again(print))
    assert (run.iteration, run.finished, run.interrupted) == (1, False, True)


def chosen(
    toys: Plugins,
    device: Device,
    wanted: Budget | Quality,
    said: Callable[[str], None] = print,
    *,
    name: str = SHORT,
    own: int | str = 400,
    quick: int | str = 160,
) -> Pipeline:
    """Return the chosen pipeline for the toy scene."""

    class Chosen(Exception):
        pass

    def load(name: str) -> Pipeline:
        assert name != SHORT, "it is at hand"
        return pipeline(toys, name, {QUICK: quick, LONG: 1200, BEST: 3600, MANY: 1600}[name])

    found: list[Pipeline] = []
    plan = (
        WithinSeconds(said, load=load, budget=wanted)
        if isinstance(wanted, Budget)
        else WithQuality(said, load=load, quality=wanted)
    )

    class Choosing(Fit):
        def fitted(self, initial: Prepared) -> Pipeline:
            found.append(plan.fitted(initial))
            raise Chosen

    with pytest.raises(Chosen):
        trained(pipeline(toys, name, own), device, Path("nowhere"), Choosing(said))
    return found[0]


@pytest.mark.parametrize(
    ("quality", "name", "iterations"),
    [("fast", QUICK, 160), ("good", SHORT, 400), ("best", BEST, 3600)],
)
def test_a_quality_is_a_pipeline_and_a_length(
    toys: Plugins, device: Device, quality: Quality, name: str, iterations: int
) -> None:
    said: list[str] = []
    found = chosen(toys, device, quality, said.append)
    assert (found.name, found.training.iterations) == (name, iterations)
    assert found.items["densification"][0].host.every == iterations // 4
    assert "2 training views of" in said[2]
    assert max(map(len, said)) <= 80


@pytest.fixture
def many(monkeypatch: pytest.MonkeyPatch) -> None:
    """The two training views of the toy scene are many."""
    monkeypatch.setattr("stereogs.quality.fitting.MANY_VIEWS", 2)


@pytest.mark.parametrize(("quality", "iterations"), [("fast", 600), ("good", 1600), ("best", 4800)])
def test_many_views_have_a_pipeline_of_their_own(
    toys: Plugins, device: Device, many: None, quality: Quality, iterations: int
) -> None:
    said: list[str] = []
    found = chosen(toys, device, quality, said.append)
    assert (found.name, found.training.iterations) == (MANY, iterations)
    assert said[-1].startswith("  because there are ")


def test_seconds_choose_the_length_for_many_views(
    toys: Plugins, device: Device, many: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = chosen(toys, device, Machine(monkeypatch).budget(600))
    assert (found.name, found.training.iterations) == (MANY, 4800)
    assert chosen(toys, device, Machine(monkeypatch).budget(30)).name == SHORT


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("modifiers.absent.rate=1", f"not {MANY}, because of the changes: "),
        ("training.iterations=999", f"trained: {SHORT}, 8 iterations"),
    ],
)
def test_many_views_train_the_usual_pipeline_if_changes_fit_only_that(
    toys: Plugins, device: Device, tmp_path: Path, many: None, change: str, said: str
) -> None:
    def load(name: str) -> Pipeline:
        return parse_pipeline(TEXT.format(name=name, iterations=4000), toys, overrides=[change])

    lines: list[str] = []
    plan = WithQuality(lines.append, load=load)
    assert trained(pipeline(toys, iterations=8), device, tmp_path / "run", plan).iteration == 8
    assert lines[0].startswith(said)


@pytest.mark.parametrize(
    ("seconds", "name"), [(12.0, QUICK), (30.0, SHORT), (100.0, LONG), (600.0, BEST)]
)
def test_seconds_choose_among_the_pipelines(
    toys: Plugins,
    device: Device,
    monkeypatch: pytest.MonkeyPatch,
    seconds: float,
    name: str,
) -> None:
    found = chosen(toys, device, Machine(monkeypatch).budget(seconds))
    assert found.name == name
    most = {
        QUICK: QUICK_TIMES * 160,
        SHORT: SHORT_TIMES * 400,
        LONG: LONG_TIMES * 1200,
        BEST: 3600,
    }[name]
    assert MIN_ITERATIONS <= found.training.iterations <= most
    assert found.training.max_gaussians is not None


def test_the_name_of_a_pipeline_may_be_changed(
    toys: Plugins, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    budget = Machine(monkeypatch).budget(30)
    assert chosen(toys, device, budget, name="other").name == "other"
    assert chosen(toys, device, "good", name="other").name == "other"


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


def test_the_chosen_pipeline_keeps_the_scene_as_it_was_read(
    toys: Plugins, device: Device, tmp_path: Path
) -> None:
    """Here `resized` changes a setting of the scene, as a smaller size of photographs does."""
    line = "colors: [0.5, 0, 0]"

    class Resized(WithQuality):
        def resized(self, pipeline: Pipeline, scene: Scene) -> Pipeline:
            text = TEXT.replace("colors: [0, 0, 0]", line).format(name=SHORT, iterations=400)
            return parse_pipeline(text, toys)

    plan = Resized(print, load=lambda name: pipeline(toys, name, 8), quality="fast")
    run = trained(pipeline(toys), device, tmp_path / "run", plan)
    assert run.pipeline.name == QUICK
    again = trained(parse_pipeline(run.pipeline_text, toys), device, tmp_path / "again")
    assert again.hash == run.hash
    assert run.pipeline.one("scene").settings != pipeline(toys).one("scene").settings


def test_the_chosen_pipeline_has_the_length_for_the_scene(toys: Plugins, device: Device) -> None:
    assert chosen(toys, device, "good", own="150 per view").training.iterations == 300
    assert chosen(toys, device, "fast", quick="30 per view").training.iterations == 60


def test_the_length_chooses_among_the_pipelines() -> None:
    times = {0.5: QUICK, 0.7: SHORT, 1.7: SHORT, 1.8: LONG, 5.2: LONG, 5.3: BEST}
    assert {number: by_length(number).name for number in times} == times
    for quality in QUALITIES:
        assert len(f"  because {by_quality(quality).reason}") <= 80
