"""What an observer is told, and a run that it listens to: stopped, resumed, and the same as without it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any
from uuid import uuid4

from core_rasterizer import Rendering

from ..contract.component import Component, Settings
from ..contract.components import Observer
from ..contract.hook_points import HookPoint
from ..events import IterationDone, RunEnded, RunStarted, ViewsScored
from ..pipeline.pipeline import Item
from ..pipeline.training_settings import TrainingSettings
from ..plugins.discovery import Offer, Plugins
from ..runs.options import RunOptions
from ..runs.training_run import resume, start
from .bench import Bench, Moment
from .companions import UNDER_TEST, item, pipeline_of
from .judging import require

_METHODS = ("started", "iterated", "evaluated", "ended")
_TRAINING = TrainingSettings(iterations=4, sh_degree=0, evaluate_every=2)


def ask_observer(bench: Bench, built: Any) -> Any:
    """Tell it of a run: of one that ends well where there is something to see, else of one that fails."""
    own = [name for name in _METHODS if getattr(type(built), name) is not getattr(Observer, name)]
    require(bool(own), f"it hears nothing: define one of {', '.join(_METHODS)}")
    with tempfile.TemporaryDirectory() as folder:
        for method, event in zip(_METHODS, _events(bench, Path(folder)), strict=True):
            bench.ask(getattr(built, method), event)


def _events(bench: Bench, folder: Path) -> Iterator[Any]:
    """What it is told, in the order of the methods."""
    moment, rich = bench.differentiated(), bench.size.rich
    step = moment.step
    yield RunStarted(
        title="a run",
        folder=folder,
        identity=uuid4().hex,
        iteration=0,
        resumed=False,
        iterations=step.iterations,
        pipeline=pipeline_of([], _TRAINING).plain(),
        facts={"scene": {"name": bench.scene.name}, "seed": 0},
        scene=step.scene,
    )
    yield _iteration(moment)
    scores: dict[str, dict[str, float | None]] = {
        "test": {"one": 20.0, "other": None},
        "train": {"one": None, "other": None},
    }
    views = {split: {"a view": row} for split, row in scores.items()}
    yield ViewsScored(step.iteration, scores, views)
    results = {"hash": "0" * 64, **scores} if rich else None
    yield RunEnded(step.iteration, rich, results, None if rich else "a loss is not finite")


def _iteration(moment: Moment) -> IterationDone:
    step, seen = moment.step, moment.step.rendering
    return IterationDone(
        iteration=step.iteration,
        seconds=1.0,
        loss=0.5,
        numbers=MappingProxyType({"photometric": 0.5, "regularizers.one": float("inf")}),
        gaussians=moment.model.count,
        learning_rates=step.learning_rates,
        view=step.view,
        target=step.sample.target,
        rendering=Rendering(seen.rgb.detach(), seen.depth.detach(), seen.alpha.detach()),
        model=step.model,
    )


def listen(component: type[Component[Any]], settings: Settings, bench: Bench) -> None:
    """Let it hear a run that is stopped half-way and resumed.

    Raises:
        AssertionError: the run ends in other bits than one without it.
        ExplainedError: the host refuses what it does, or it failed.
    """
    observer = item(component, settings, UNDER_TEST)
    alone, heard = pipeline_of([], _TRAINING), pipeline_of([observer], _TRAINING)
    options = RunOptions(scene=bench.scene, device=bench.device, progress=False)
    expected = start(alone, options)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "run"
        half = _TRAINING.iterations // 2
        start(heard, replace(options, callback=lambda done: done.number < half), folder)
        run = resume(folder, options, _These(list(heard)))
    require(run.hash == expected.hash, "the run ends in other bits than one without the observer")


class _These(Plugins):
    """Of plugins, those of a pipeline that was made by hand."""

    def __init__(self, items: list[Item]) -> None:
        super().__init__(())
        self._known = {(item.point.section, item.offer.name): item.offer for item in items}

    def find(self, point: HookPoint, name: str) -> Offer:
        """The pipeline's own."""
        return self._known[point.section, name]
