"""Choose the size of the photographs and the pipeline.

The run's pipeline records all choices, so that it can be repeated. For a limited time: `within_seconds`.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from registry import RunError
from registry.errors import PipelineError
from registry.messages.suggestions import counted
from registry.pipeline.pipeline import Pipeline
from registry.runs.folder import ChooseFolder, refuse_occupied
from registry.runs.preparation import Prepared, load, prepare, running
from registry.runs.training_run import train_prepared

from .table import FOR_MANY, MANY, MANY_LEAST, MANY_TIMES, MANY_VIEWS, SHORT, Quality, by_quality

if TYPE_CHECKING:
    from pathlib import Path

    from registry import Scene
    from registry.runs.options import RunOptions
    from registry.runs.run import Run
    from registry.training.trainer import Iteration


NEARLY = 0.95
"""Photographs smaller than this multiple of the wanted size are reported; lenses crop a few pixels."""
HURRIED = "hurried"
"""Name of the fact in results.json, which the report shows."""

Load = Callable[[str], Pipeline]
"""Returns a ready pipeline by name, with the scene and changes of the command line."""
Log = Callable[[str], None]


@dataclass
class Fit:
    """Trains the given pipeline, on smaller photographs if memory is short.

    Subclasses choose the pipeline and its length. The pipeline of the run records all choices: training it
    alone gives the same bits.

    Args:
        log: receives lines of at most 80 characters.
        size: longer side of the photographs in pixels, if it is given.
        adapts_size: whether time and memory choose the size.
        kept: settings that the command line names, such as "scene.frames".
        device: part of the name of the OpenCL device.
    """

    log: Log
    size: int | None = None
    adapts_size: bool = False
    kept: Collection[str] = ()
    device: str | None = None
    _shrunk: bool = field(default=False, init=False)

    def train(
        self, pipeline: Pipeline, options: RunOptions, out: Path | ChooseFolder | None = None
    ) -> Run:
        """Train the pipeline that fits; arguments, answer and errors as for `start_run`."""
        refuse_occupied(out)
        with running(options) as active:
            pipeline = self.hastened(pipeline)
            loaded = load(pipeline, active)
            resized = self.resized(pipeline, loaded.scene)
            if resized is not pipeline:
                loaded = loaded.again(resized)
            initial = prepare(loaded, active)
            fitted = self.fitted(initial)
            if fitted is not initial.pipeline:
                initial = initial.of(fitted)
            return self._train(_noting(initial, self.hurried(initial)), active, out)

    def _train(
        self, initial: Prepared, options: RunOptions, out: Path | ChooseFolder | None
    ) -> Run:
        """Train to the end, or until `corrected` returns a pipeline, and then that one in the same folder."""
        total, corrections = initial.pipeline.training.iterations, list[Pipeline]()

        def watch(done: Iteration) -> bool:
            if options.callback is not None and options.callback(done) is False:
                return False
            corrected = self.corrected(done.number, total)
            corrections.extend([] if corrected is None else [corrected])
            return corrected is None

        run = train_prepared(initial, replace(options, callback=watch), out)
        if not corrections or run.interrupted:
            return run
        if run.folder is not None:
            out = run.folder.path
            shutil.rmtree(out)
        shorter = initial.of(corrections[0])
        return self._train(_noting(shorter, self.hurried(shorter)), options, out)

    def hastened(self, pipeline: Pipeline) -> Pipeline:
        """Return the pipeline with settings of the loader that take less time, if time is short."""
        return pipeline

    def resized(self, pipeline: Pipeline, scene: Scene) -> Pipeline:
        """Return the pipeline with smaller photographs if time or memory is short.

        Raises:
            RunError: a size is given, and the pipeline follows a protocol.
        """
        longer = max(max(view.camera.width, view.camera.height) for view in scene.train)
        if self.size is not None:
            if pipeline.protocol is not None:
                raise RunError(
                    f"the protocol {pipeline.protocol.protocol.name!r} fixes the size of the photographs",
                    where=f"--size {self.size}",
                    fix="leave --size out, or use no protocol: --set protocol=null",
                )
            if longer < NEARLY * self.size:
                self.log(f"the photographs have {longer} pixels and are not enlarged")
        loader = pipeline.one("scene")
        known = hasattr(loader.settings, "max_size") and pipeline.protocol is None
        if not self.adapts_size or not known:
            return pipeline
        from core_rasterizer import open_device

        from .sizing import smaller_size

        found = smaller_size(scene, self._cpu_seconds_left(), open_device(self.device))
        if found is None:
            return pipeline
        self._shrunk = True
        self.log(f"photographs: {found.pixels} pixels instead of {longer}: {found.reason} is short")
        self.log("  --size PIXELS chooses the longer side")
        return with_loader(pipeline, {"max_size": found.pixels})

    def _cpu_seconds_left(self) -> float | None:
        """CPU seconds that the process can expect until the end of the budget; None: no limit."""
        return None

    def fitted(self, initial: Prepared) -> Pipeline:
        """Return the pipeline that trains, with the same scene, priors and initializer."""
        return initial.pipeline

    def hurried(self, initial: Prepared) -> str:
        """Return how little the time allowed, and the command for a better scene; "" if it was enough."""
        return ""

    def corrected(self, done: int, total: int) -> Pipeline | None:
        """Return a pipeline to start training again with, or None; called after each iteration.

        Args:
            done, total: the number of the iteration, and of the last one.
        """
        return None

    def closing(self, run: Run) -> Iterator[str]:
        """Yield what to report after a finished run."""
        return iter(())


@dataclass
class WithQuality(Fit):
    """Trains a folder with the pipeline of a quality.

    Args:
        load: loads the ready pipelines, which initialize in the same way; the given one is SHORT, perhaps
            with another name.
    """

    load: Load = field(kw_only=True)
    quality: Quality = "good"

    def fitted(self, initial: Prepared) -> Pipeline:
        """Return the pipeline of the quality for the number of training views."""
        many = pipeline_for_many(initial, self.load, self.log)
        if many is None:
            choice = by_quality(self.quality)
            chosen = ready(choice.name, initial, self.load)
        else:
            choice = FOR_MANY
            chosen = many.scaled(round(MANY_TIMES[self.quality] * many.training.iterations))
        log_choice(chosen, choice.reason, initial, self.log)
        return chosen

    def closing(self, run: Run) -> Iterator[str]:
        """Yield the command that repeats the run."""
        yield f"repeat    stereogs train {run.folder_or_refuse().pipeline}"


def with_loader(pipeline: Pipeline, changes: Mapping[str, object]) -> Pipeline:
    """Return the pipeline with other settings of its loader."""
    loader = pipeline.one("scene")
    changed = replace(loader, settings=loader.settings.model_copy(update=dict(changes)))
    return replace(pipeline, items={**pipeline.items, "scene": (changed,)}) if changes else pipeline


def _noting(initial: Prepared, hurried: str) -> Prepared:
    """Return the state with the sentence among the facts that results and report show, or without one."""
    facts = {name: fact for name, fact in initial.points.facts.items() if name != HURRIED}
    facts |= {HURRIED: hurried} if hurried else {}
    return replace(initial, points=replace(initial.points, facts=facts))


def ready(name: str, initial: Prepared, load: Load) -> Pipeline:
    """Load a pipeline of the table for the number of training views, with the scene as it was read."""
    if name == SHORT:
        return initial.pipeline
    loaded = load(name).for_views(len(initial.scene.train))
    return replace(loaded, items={**loaded.items, "scene": initial.pipeline.items["scene"]})


def pipeline_for_many(initial: Prepared, load: Load, log: Log) -> Pipeline | None:
    """Return the pipeline for many views; None for few views or iterations, or if changes do not fit it."""
    if len(initial.scene.train) < MANY_VIEWS:
        return None
    try:
        many = ready(MANY, initial, load)
    except PipelineError as error:
        log(f"not {MANY}, because of the changes: {error.what}")
        return None
    return many if many.training.iterations >= MANY_LEAST else None


def log_choice(chosen: Pipeline, reason: str, initial: Prepared, log: Log) -> None:
    """Log the pipeline, the scene and the reason in lines of at most 80 characters."""
    training, camera = chosen.training, initial.scene.train[0].camera
    log(f"trained: {chosen.name}, {training.iterations:,} iterations")
    log(f"  from    {_from(len(initial.gaussians), training.max_gaussians)}")
    views = f"{counted(len(initial.scene.train), 'training view')} of {camera.width}x{camera.height} pixels"
    kind = initial.points.facts.get("scene_kind")
    log(f"  for     {views}" + (f", {kind}" if kind else ""))
    if reason:
        log(f"  because {reason}")


def _from(first: int, limit: int | None) -> str:
    """Describe the growth; the limit bounds new Gaussians and removes none."""
    if limit is None:
        return f"{first:,} Gaussians"
    if first == limit:
        return f"{first:,} Gaussians, without growth"
    if first > limit:
        return f"{first:,} Gaussians, without growth: the limit of growth is {limit:,}"
    return f"{first:,} Gaussians, which grow to at most {limit:,}"
