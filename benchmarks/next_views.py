"""Choose the 4th to 6th photograph by rules, and score the scene after each: `make bench-next`.

From three photographs of a pool on, each rule adds one after another: what `stereogs next` suggests, the
middle of the longest gap in the order of the capture, the camera farthest from the others, or a random one
(five draws). Each set is trained with `weightfree_quick` on small photographs and scored on the test views,
which no rule uses. Every choice of the 4th photograph is trained, for their mean and the best of them.
Finished trainings are kept in `benchmarks/records/next_views.jsonl`: the same command continues where it
stopped. Changes of the code are not detected; remove the file after one. With `--write-docs` rewrites the
tables.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass
from time import process_time

from benchmarks.next_views_page import SUGGESTED, Measured, summary, table, write_page
from benchmarks.next_views_rules import RULES, Chosen, suggested
from benchmarks.next_views_scenes import PIPELINE, SCENES, PoolScene, pool_scene
from benchmarks.records import RECORDS, append, lines
from benchmarks.trainings import check_data
from registry import RunError
from registry.calls.process_state import one_torch_thread
from registry.runs.evaluation import evaluate
from registry.runs.run import Run
from stereogs.session import train

FILE = RECORDS / "next_views.jsonl"
LAST = 6
"""Photographs at the end."""


@dataclass(frozen=True)
class ScoredSet:
    """One set of photographs.

    Args:
        views: indices in the pool, ascending.
        psnr: mean over the test views, dB.
        cpu_seconds: of the training, all threads, without scoring.
        hash: SHA-256 of the Gaussians.
    """

    scene: str
    views: Chosen
    psnr: float
    cpu_seconds: float
    hash: str


@dataclass(frozen=True)
class Suggestion:
    """The photograph that follows a set.

    Args:
        views: indices in the pool, ascending.
        next: index in the pool.
        cpu_seconds: of the suggestion, all threads, without the training.
    """

    scene: str
    views: Chosen
    next: int
    cpu_seconds: float


class RecordedSets:
    """Trains each set once, and remembers what earlier commands measured.

    Args:
        train_missing: if False, it raises `NotRecorded` instead of training.
    """

    def __init__(self, *, train_missing: bool = True) -> None:
        self._train_missing = train_missing
        self._trainings, self._suggestions = read_records()
        self._newest: tuple[tuple[str, Chosen], Run] | None = None

    def psnr(self, scene: PoolScene, views: Chosen) -> float:
        """Return the mean PSNR of the test views; train unless it is recorded."""
        key = scene.name, tuple(sorted(views))
        if key not in self._trainings:
            self._trained(scene, views)
        return self._trainings[key].psnr

    def following(self, scene: PoolScene, views: Chosen) -> int:
        """Return the photograph that is suggested after some; train unless it is recorded."""
        key = scene.name, tuple(sorted(views))
        if key not in self._suggestions:
            run = self._trained(scene, views)
            begin = process_time()
            with one_torch_thread():
                chosen = suggested(scene, views, run)
            seconds = round(process_time() - begin, 2)
            self._suggestions[key] = Suggestion(*key, chosen, seconds)
            append(asdict(self._suggestions[key]), FILE)
        return self._suggestions[key].next

    def _trained(self, scene: PoolScene, views: Chosen) -> Run:
        key = scene.name, tuple(sorted(views))
        if not self._train_missing:
            raise NotRecorded(*key)
        if self._newest is None or self._newest[0] != key:
            begin = process_time()
            run = train(PIPELINE, scene=scene.of(views), progress=False)
            seconds = round(process_time() - begin, 2)
            if not run.finished:  # by Ctrl-C or SIGTERM
                raise RunError("the training was stopped", where=scene.name, fix="start it again")
            self._newest = key, run
            if key not in self._trainings:
                self._trainings[key] = ScoredSet(*key, _psnr(run), seconds, run.hash)
                append(asdict(self._trainings[key]), FILE)
        return self._newest[1]


def _psnr(run: Run) -> float:
    with one_torch_thread():
        metrics = [part for part in run.parts["metrics"] if part.item.name == "psnr"]
        mean = evaluate(run.engine_model, run.framed, run.framed.test, metrics).mean["psnr"]
    if mean is None:
        raise RunError(
            "a view has no score",
            where=run.scene.name,
            fix="choose a scene whose test views psnr can score",
        )
    return round(mean, 4)


def read_records() -> tuple[
    dict[tuple[str, Chosen], ScoredSet], dict[tuple[str, Chosen], Suggestion]
]:
    """Return the trainings and the suggestions by scene and set; the last of each counts."""
    trainings, suggestions = {}, {}
    for values in lines(FILE):
        key = values["scene"], tuple(values.pop("views"))
        values.pop("code", None)  # older records have a digest of the code
        if "psnr" in values:
            trainings[key] = ScoredSet(views=key[1], **values)
        else:
            suggestions[key] = Suggestion(views=key[1], **values)
    return trainings, suggestions


class NotRecorded(Exception):
    """A training is missing that must not be made."""


def paths(bench: RecordedSets, scene: PoolScene) -> dict[str, list[float]]:
    """Return the PSNR after the start and each further photograph, by rule, as far as there are records."""
    curves: dict[str, list[float]] = {}
    for name in (SUGGESTED, *RULES):
        chosen, curves[name] = scene.start, []
        try:
            curves[name].append(bench.psnr(scene, chosen))
            while len(chosen) < LAST:
                rule = RULES.get(name, bench.following)
                chosen = (*chosen, rule(scene, chosen))
                curves[name].append(bench.psnr(scene, chosen))
        except NotRecorded:
            continue
    return curves


def every_fourth(bench: RecordedSets, scene: PoolScene) -> list[float]:
    """Return the PSNR of every choice of the 4th photograph."""
    pool = range(len(scene.cameras))
    return [bench.psnr(scene, (*scene.start, k)) for k in pool if k not in scene.start]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write-docs", action="store_true", help="also write the tables")
    parser.add_argument("--finished", action="store_true", help="use only records that exist")
    parser.add_argument("--scenes", default=",".join(SCENES), help="separated by commas")
    arguments = parser.parse_args()
    names = arguments.scenes.split(",")
    check_data(names)
    bench, measured = RecordedSets(train_missing=not arguments.finished), []
    for name in names:
        scene = pool_scene(name)
        measured.append(Measured(name, paths(bench, scene), every_fourth(bench, scene)))
        print(table([measured[-1]]), flush=True)
    print(table(measured) + "\n" + summary(measured))
    if arguments.write_docs:
        write_page(measured)


if __name__ == "__main__":
    main()
