"""A run: a pipeline, a scene and the Gaussians, during training, after it, or read from its folder."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import count, islice
from pathlib import Path
from time import monotonic
from typing import Any
from uuid import uuid4

from torch import Tensor

from core_rasterizer import Camera, ExplainedError, GaussianReader, Model, Rendering, save_ply

from ..calls.copies import copied
from ..confidence import Confidence, Trained
from ..contract.components import ViewMetric
from ..contract.scene import Scene
from ..discovery import CONFIDENCE, Plugins
from ..errors import RunError
from ..pipeline.parts import Part, Parts, build_part
from ..pipeline.pipeline import Pipeline
from ..pipeline.single_item import single_item
from ..system.files import jsonable
from ..system.memory import peak_memory_mb
from ..toolkit.progress import progress, tracked
from ..training.checkpoint import CHECKPOINT, Checkpoint, save_checkpoint
from ..training.trainer import maps_of, one_torch_thread
from .evaluation import Picture, Scores, as_arrays, clamped_render, evaluate, quick
from .folder import RunFolder
from .origin import (
    changed_inputs,
    circumstances,
    input_digests,
    listed,
    refuse_changed_plugins,
    with_packages,
)
from .results import EXPORTS, RENDERS, Failure, Results, add_scores, describe, existing_files

Sums = dict[str, tuple[float, int]]
SUMS = "sums"
"""Prefix of `Run.sums` in checkpoints."""
_log = logging.getLogger(__name__)


@dataclass
class Stages:
    """Wall-clock seconds of each stage; `outputs` are exporters and reports, imports do not count.

    After a resume, `scene` is the time of the last loading.
    """

    scene: float = 0.0
    initialization: float = 0.0
    training: float = 0.0
    evaluation: float = 0.0
    outputs: float = 0.0

    def rounded(self) -> dict[str, float]:
        """Return seconds by name, to milliseconds."""
        return {name: round(value, 3) for name, value in asdict(self).items()}


@dataclass(eq=False)
class Run:
    """A pipeline, its scene, and the Gaussians trained so far.

    Args:
        pipeline: the pipeline that trains.
        parts: its components.
        scene: the training and test views.
        model: the Gaussians.
        checkpoint: returns everything that training needs to continue from here.
        iteration: the last complete iteration.
        initialization: facts reported by the initializer.
        pictures: pictures drawn by the initializer, `[H, W, 3]` in [0, 1] by name.
        seconds: wall-clock time of each stage.
        metrics: lines of metrics.jsonl; empty for a run read from a folder.
        sums: sum and count of each number that the next line will average.
        folder: the run folder; None: in memory only.
        changed: inputs that changed since the run began, and were accepted.
        identity: unique identifier of the run; "" without a folder.
        saved_iteration: iteration of the newest checkpoint in the folder.
        interrupted: whether Ctrl-C or SIGTERM stopped it.
    """

    pipeline: Pipeline
    parts: Parts
    scene: Scene
    model: Model
    checkpoint: Callable[[], Checkpoint]
    iteration: int = 0
    initialization: dict[str, Any] = field(default_factory=dict)
    pictures: dict[str, Tensor] = field(default_factory=dict)
    seconds: Stages = field(default_factory=Stages)
    metrics: list[dict[str, Any]] = field(default_factory=list)
    sums: Sums = field(default_factory=dict)
    folder: RunFolder | None = None
    changed: tuple[str, ...] = ()
    identity: str = ""
    saved_iteration: int | None = None
    interrupted: bool = False
    _scores: tuple[int, dict[str, Scores]] | None = None

    @cached_property
    def pipeline_text(self) -> str:
        """The pipeline as YAML, with every default."""
        return self.pipeline.to_yaml()

    @property
    def finished(self) -> bool:
        """Whether the last iteration of the pipeline is complete."""
        return self.iteration >= self.pipeline.training.iterations

    @property
    def hash(self) -> str:
        """SHA-256 of the Gaussians, equal for equal bits."""
        return self.model.digest()

    @property
    def kinds(self) -> dict[str, Tensor]:
        """Which Gaussians descend from initial points of a kind, `[N]` bool by its name.

        Empty if the initializer does not distinguish kinds (`PointCloud.kinds`).
        """
        return self.checkpoint().part("kinds")

    def confidence(self, name: str, changes: Sequence[str] = ()) -> Confidence:
        """Return the confidence in renders of the Gaussians.

        Args:
            name: an installed estimator, for example "calibrated", "coverage" or "fisher".
            changes: `key=value`, settings of the estimator.
        """
        item = single_item(Plugins().find(CONFIDENCE, name), changes)
        part = build_part(item, self.pipeline.training.seed, self.model.engine)
        with part.at_work(), one_torch_thread():
            answer: Confidence = part.component.estimate(self.trained)
        return answer

    @property
    def trained(self) -> Trained:
        """The Gaussians and what they were trained on; of the inputs, copies."""
        maps = maps_of(self.checkpoint().part("maps"))
        inputs = copied((self.scene.for_training(), maps, self.kinds))
        return Trained(GaussianReader(self.model), *inputs, self.confidence)

    @property
    def scores(self) -> dict[str, Scores]:
        """Scores by split, "test" and "train", computed on first use: `scores["test"].mean["psnr"]`."""
        if self._scores is None or self._scores[0] != self.iteration:
            return self.evaluate()
        return self._scores[1]

    def evaluate(self, pictures: Path | None = None) -> dict[str, Scores]:
        """Render and score all views; draw the test views, or if there are none the others, into a folder."""
        begin = monotonic()
        scene, metrics = self.scene, self.parts["metrics"]
        of_train = None if scene.test else pictures
        begun = ViewMetric.begin_scoring
        if asking := [p for p in metrics if type(p.component).begin_scoring is not begun]:
            trained = self.trained
            for part in asking:
                with part.at_work():
                    part.component.begin_scoring(trained)
        with one_torch_thread():
            views = tracked([*scene.test, *scene.train], "scoring")
            test = islice(views, len(scene.test))
            scores = {
                "test": evaluate(self.model, scene, test, metrics, pictures, repeat=True),
                "train": evaluate(self.model, scene, views, quick(metrics), of_train),
            }
        self.seconds.evaluation = monotonic() - begin
        self._scores = (self.iteration, scores)
        return scores

    def rendering(self, camera: Camera) -> Rendering:
        """Render a camera on the scene's background as tensors, without gradients, colours in [0, 1]."""
        return clamped_render(self.model, camera, self.scene.background)

    def render(self, camera: Camera) -> Picture:
        """Render a camera on the scene's background as numpy arrays."""
        return as_arrays(self.rendering(camera))

    def export(self, path: str | os.PathLike[str]) -> Path:
        """Write the Gaussians as a PLY file for viewers of 3D Gaussian Splatting."""
        file = Path(path).expanduser()
        save_ply(self.model.gaussians(), file)
        return file

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write the run folder that training with `out=folder` would have written, with one checkpoint.

        Raises:
            RunError: the run has a folder already, or this one is not empty.
        """
        if self.folder is not None:
            raise RunError(
                "the run has a folder already",
                where=str(self.folder.path),
                fix="copy that folder; a run folder can be moved",
            )
        self.keep_in(Path(folder).expanduser())
        kept_in = self.folder_or_refuse()
        if self.finished:
            with kept_in.locked():
                self.finish()
        return kept_in.path

    def keep_in(self, path: Path) -> None:
        """Create the run folder with a checkpoint; later files go there too. See `RunFolder.create`."""
        self.identity = uuid4().hex
        provenance = {
            "run": self.identity,
            "seed": self.pipeline.training.seed,
            **circumstances(self.pipeline, self.model.engine),
            "resumed": [],
        }

        def fill(folder: RunFolder) -> None:
            folder.write_initialization(self.initialization, self.pictures)
            save_checkpoint(self.checkpoint(), folder.folder(CHECKPOINT))
            for line in self.metrics:
                folder.append_metrics(line)

        folder = RunFolder(path)
        digests = input_digests(self.scene, self.pipeline)
        folder.create(self.pipeline_text, provenance, digests, fill)
        self.folder, self.saved_iteration = folder, self.iteration

    def record_changes(self) -> None:
        """Write to inputs.json which inputs have changed; called before the first output from them."""
        if self.changed and self.folder is not None:
            self.folder.write_inputs(input_digests(self.scene, self.pipeline), self.changed)

    def check_folder(self) -> None:
        """Refuse to write into a folder that was moved or removed; the run is kept in a new one beside it.

        Raises:
            RunError: names the new folder.
        """
        if self.folder is None or self.folder.pipeline.is_file():
            return
        lost, self.folder = self.folder.path, None
        names = (lost.with_name(f"{lost.name}-kept-{number}") for number in count(1))
        self.keep_in(kept := next(path for path in names if not path.exists()))
        raise RunError(
            f"the run folder was moved or removed during training; iteration {self.iteration} is kept "
            f"in {kept}",
            where=str(lost),
            fix=f"stereogs resume {kept}",
        )

    def add_metrics(self, line: dict[str, Any]) -> None:
        """Add a line of metrics, also to the folder."""
        self.metrics.append(line)
        self.check_folder()
        if self.folder is not None:
            self.folder.append_metrics(line)

    def save_checkpoint(self) -> None:
        """Write a checkpoint to the folder, unless its newest is of this iteration."""
        self.check_folder()
        if self.folder is not None and self.saved_iteration != self.iteration:
            save_checkpoint(self.checkpoint(), self.folder.folder(CHECKPOINT))
            self.saved_iteration = self.iteration

    def folder_or_refuse(self) -> RunFolder:
        """Return the folder, or raise a RunError if the run is in memory only."""
        if self.folder is None:
            raise RunError("the run is in memory only", fix="save it first: run.save(folder)")
        return self.folder

    def describe(self) -> Results:
        """Return results without scores and times."""
        return describe(self.pipeline, self.scene, self.model, self.iteration)

    def finish(self) -> None:
        """Evaluate, write results.json, export and report, all in the run folder.

        If a metric, an exporter or a report fails, the others still run; the results list the failures.
        """
        folder = self.folder_or_refuse()
        self._check_inputs(folder)
        before = folder.results().get("hash")
        results = self._scored({})
        if before not in (None, results.hash):
            _log.warning("the hash was %s when the run was finished before", before)
        results.peak_memory_mb = peak_memory_mb()
        begin = monotonic()
        self._write_with_outputs(results)
        self.seconds.outputs = monotonic() - begin
        self._add_times(results)
        folder.write_results(results)

    def _check_inputs(self, folder: RunFolder) -> None:
        """Refuse to score with photographs or cameras that a component overwrote, unseen by the guards."""
        before, _ = folder.inputs()
        changed = changed_inputs(before or {}, input_digests(self.scene, self.pipeline))
        if before and changed:
            folder.write_inputs(before, changed)  # results of `eval` list them
            raise RunError(
                f"a component wrote into the inputs during training: {listed(changed)}",
                where=str(folder.path),
                fix="train again with --check-plugins, which names the component",
            )

    def renew(self, *, accept_changed_plugins: bool = False) -> dict[str, Any]:
        """Score the run again, renew its results.json and pictures, and return the results.

        For a finished run, export and report again too. Refuses a results.json of a later iteration, and
        metrics that are missing, or that have changed unless `accept_changed_plugins`.
        """
        folder = self.folder_or_refuse()
        with folder.locked():
            before = folder.results()
            packages = {**folder.plugins, **before.get("packages", {})}
            for name, error in self.pipeline.missing.items():
                if name.startswith("metrics."):
                    raise with_packages(error, packages)
            metrics = self.pipeline.items["metrics"]
            refuse_changed_plugins(packages, metrics, folder.path, accept=accept_changed_plugins)
            recorded = before.get("iterations", 0)
            if recorded > self.iteration:
                raise RunError(
                    f"results.json is of iteration {recorded}, the newest intact checkpoint of "
                    f"{self.iteration}",
                    where=str(folder.path),
                    fix=f"train to the end again: stereogs resume {folder.path}",
                )
            self.record_changes()
            results = self._scored(before)
            if self.finished:
                self._write_with_outputs(results)
            else:
                folder.write_results(results)
        return results.plain()

    def report(self, reports: Sequence[Part]) -> tuple[list[str], list[Failure]]:
        """Write reports about the finished run, whether or not its pipeline names them.

        Returns:
            The files, relative to the run folder, and the failures. The files are added to results.json.
        """
        folder = self.folder_or_refuse()
        with folder.locked():
            files, failures = self._report(reports)
            results = Results.model_validate(folder.results())
            results.reports = list(dict.fromkeys([*results.reports, *files]))
            folder.write_results(results)
        return files, failures

    def _scored(self, before: dict[str, Any]) -> Results:
        """Score both splits, draw pictures into the folder (`evaluate`), and return updated results."""
        folder = self.folder_or_refuse()
        results = Results.model_validate({**before, **self.describe().plain()})
        results.packages = {**before.get("packages", {}), **results.packages}
        results.changed_inputs = folder.inputs()[1]
        scores = self.evaluate(folder.folder(RENDERS))
        add_scores(results, **scores)
        if not before:
            results.initialization = jsonable(self.initialization)
            per_second = self.iteration / max(self.seconds.training, 1e-9)
            results.iterations_per_second = round(per_second, 3)
            self._add_times(results)
        return results

    def _add_times(self, results: Results) -> None:
        results.stages = self.seconds.rounded()
        results.seconds = results.stages["training"]
        results.seconds_total = round(sum(results.stages.values()), 3)

    def _write_with_outputs(self, results: Results) -> None:
        """Write results.json before anything else can fail; then export, report, and write it again."""
        folder = self.folder_or_refuse()
        results.exports, results.reports = [], []
        folder.write_results(results)
        exporters = self.parts["exporters"]
        place = folder.folder(EXPORTS) if exporters else folder.path
        progress("files")
        results.exports, failures = self._outputs(
            exporters,
            lambda exporter: exporter.export(GaussianReader(self.model), copied(self.scene), place),
        )
        results.failures += failures
        folder.write_results(results)  # for the reports
        results.reports, failures = self._report(self.parts["reports"])
        results.failures += failures
        folder.write_results(results)

    def _report(self, reports: Sequence[Part]) -> tuple[list[str], list[Failure]]:
        path = self.folder_or_refuse().path
        progress("page")
        return self._outputs(reports, lambda report: report.write(path, copied(self.scene)))

    def _outputs(
        self, parts: Sequence[Part], write: Callable[[Any], Any]
    ) -> tuple[list[str], list[Failure]]:
        """Return the files that components wrote, relative to the folder where possible, and failures.

        Args:
            write: calls a component, and returns its answer.
        """
        root = self.folder_or_refuse().path
        files: list[str] = []
        failures: list[Failure] = []
        for part in parts:
            try:
                with part.at_work():
                    written = existing_files(write(part.component))
            except ExplainedError as error:
                failures.append(Failure.of(part.item.qualified_name, error))
            else:
                files += [
                    str(f.relative_to(root) if f.is_relative_to(root) else f) for f in written
                ]
        return files, failures
