"""How well confidence predicts the errors of test views: `python -m benchmarks.confidence`.

Trains `weightfree_quick` on each scene and compares the estimators. A record of each training is added to
`benchmarks/records/confidence.jsonl`; a recorded one is not repeated, so the same command continues where it
stopped. Changes of the code are not detected; remove the file after one. `--write-docs` rewrites the tables.

`--fit` trains on two thirds of the training views and fits the weights of `calibrated` to the errors on the
others. It uses no test view.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from statistics import fmean
from time import process_time
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

import stereogs
from benchmarks import pages
from benchmarks.confidence_measures import auroc, ause, rank_correlation, reliability
from benchmarks.left_out_scenes import OVERRIDES
from benchmarks.records import RECORDS, append, lines
from benchmarks.trainings import PIPELINES
from registry import Scene, View
from registry.calls.process_state import one_torch_thread
from registry.runs.run import Run
from registry.toolkit.images import predicted_psnr
from stereogs.experiments.showing.score_table import markdown
from stereogs_plugins.confidence.estimators.calibrated import CalibratedConfidence, Evidence

FILE = RECORDS / "confidence.jsonl"
CASES = (
    *(f"llff_{name}-3" for name in ("fern", "flower", "fortress", "room")),
    *(f"dtu_scan{number}-3" for number in (24, 65, 114)),
    "blender_lego-8",
    "mip360_bonsai-12",
)
ESTIMATORS = ("fisher", "support", "coverage", "calibrated")
BASELINE, OURS = "fisher", "calibrated"
SEEDS = (0, 1, 2)
MAX_VIEWS = 16
"""Test views of a scene that are measured, evenly spaced."""
SAMPLES = 2000
"""Pixels of a left-out view that the weights are fitted to."""
FOLDS = 3
_QUICK = ["metrics=[psnr]", "reports=[]", "exporters=[]", "protocol=null"]
_STEPS, _RIDGE = 40, 1e-3


def scene_of(case: str, fold: int | None = None) -> Scene:
    """Return a scene with its test views, or with every third training view as test view instead."""
    scene = stereogs.load_scene(
        stereogs.build_pipeline(PIPELINES / "weightfree_quick.yaml", OVERRIDES[case])
    )
    if fold is None:
        count = min(len(scene.test), MAX_VIEWS)
        return replace(
            scene, test=tuple(scene.test[k * len(scene.test) // count] for k in range(count))
        )
    kept = tuple(view for index, view in enumerate(scene.train) if index % FOLDS != fold)
    tested = tuple(view for index, view in enumerate(scene.train) if index % FOLDS == fold)
    return replace(scene, train=kept, test=tested)


def trained(scene: Scene, seed: int) -> Run:
    """Return a run in memory."""
    changes = [*_QUICK, f"training.seed={seed}"]
    pipeline = stereogs.build_pipeline(PIPELINES / "weightfree_quick.yaml", changes)
    return stereogs.train(pipeline, scene=scene, progress=False)


def measured(case: str, seed: int) -> dict[str, Any]:
    """Train, and return the record of one scene."""
    begin = process_time()
    run = trained(scene_of(case), seed)
    record: dict[str, Any] = {"case": case, "seed": seed, "train_cpu_s": process_time() - begin}
    views = run.scene.test
    errors = [_errors(run, view) for view in views]
    for name in ESTIMATORS:
        begin = process_time()
        confidence = run.confidence(name)
        fitted = process_time()
        with one_torch_thread():
            maps = [_inside(confidence.of(view.camera), view) for view in views]
        ended = process_time()
        every, sure = np.concatenate([e for e, _ in errors]), np.concatenate(maps)
        record[name] = {
            "ause_mae": ause(every, sure),
            "ause_rmse": ause(every, sure, squared=True),
            "auroc": auroc(every, sure),
            "psnr": {
                view.name: (round(psnr, 3), round(predicted_psnr(torch.from_numpy(its)), 3))
                for view, (_, psnr), its in zip(views, errors, maps, strict=True)
            },
            "reliability": reliability(every, sure),
            "fit_cpu_s": fitted - begin,
            "view_cpu_s": (ended - fitted) / len(views),
        }
    return json.loads(json.dumps(record), parse_float=lambda text: round(float(text), 4))  # type: ignore[no-any-return]


def _inside(values: torch.Tensor, view: View) -> NDArray[np.float64]:
    chosen = values if view.mask is None else values[view.mask]
    return chosen.double().flatten().numpy()


def _errors(run: Run, view: View) -> tuple[NDArray[np.float64], float]:
    """Return the error of each pixel and the PSNR of a view."""
    difference = run.rendering(view.camera).rgb - view.image
    squares = _inside(difference.square().mean(dim=2), view)
    return _inside(difference.abs().mean(dim=2), view), float(-10 * np.log10(squares.mean()))


def recorded() -> list[dict[str, Any]]:
    """Return the records, in the order of the file."""
    return [*lines(FILE)]


def tables(records: Sequence[Mapping[str, Any]]) -> str:
    """Return a row for each scene and estimator, means over seeds, and one for all."""
    rows = []
    for case in dict.fromkeys(record["case"] for record in records):
        its = [record for record in records if record["case"] == case]
        rows += [[case, name, *_row(its, name)] for name in ESTIMATORS]
    rows += [["all", name, *_row(records, name)] for name in ESTIMATORS]
    headings = ["scene-views", "estimator", "AUSE MAE", "AUSE RMSE", "AUROC", "rank", "runs"]
    text = markdown(headings, rows, names=2)
    return f"{text}\nReliability of `{OURS}`, all scenes:\n\n{_reliability(records)}"


def _row(records: Sequence[Mapping[str, Any]], name: str) -> list[str]:
    its = [record[name] for record in records]
    known = [one["auroc"] for one in its if one["auroc"] is not None]
    pairs = [pair for one in its for pair in one["psnr"].values()]
    rank = rank_correlation(*zip(*pairs, strict=True)) if len(pairs) > 2 else float("nan")
    means = [fmean(one[key] for one in its) for key in ("ause_mae", "ause_rmse")]
    numbers = [*means, fmean(known) if known else float("nan"), rank]
    return [*(f"{number:.3f}" for number in numbers), str(len(its))]


def _reliability(records: Sequence[Mapping[str, Any]]) -> str:
    tenths = np.array([record[OURS]["reliability"] for record in records])
    counts = tenths[..., 0].sum(axis=0)
    means = (tenths[..., :1] * tenths[..., 1:]).sum(axis=0) / counts.clip(1)[:, None]
    rows = [
        [f"{mean:.2f}", f"{right:.2f}", f"{count / counts.sum():.1%}"]
        for count, (mean, right) in zip(counts, means, strict=True)
        if count
    ]
    return markdown(["confidence", "share of right pixels", "of all pixels"], rows, names=0)


def summary(records: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of the documentation: means over scenes and seeds."""
    rows = [[f"`{name}`", *_row(records, name)[:-1]] for name in ESTIMATORS]
    return markdown(["estimator", "AUSE MAE", "AUSE RMSE", "AUROC", "rank"], rows)


def left_out(seed: int = 0) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Yield evidence `[SAMPLES, E]` and errors `[SAMPLES]` of each training view that was left out."""
    draw = np.random.default_rng(seed)
    for case, fold in product(CASES, range(FOLDS)):
        run = trained(scene_of(case, fold), seed)
        confidence = run.trained.confidence(OURS)
        assert isinstance(confidence, CalibratedConfidence)
        for view in run.scene.test:
            with one_torch_thread():
                camera = run.frame.camera_of_file(view.camera)
                parts = [_inside(torch.as_tensor(e), view) for e in confidence.evidence(camera)]
            errors, _ = _errors(run, view)
            chosen = draw.permutation(len(errors))[:SAMPLES]
            yield np.stack(parts, axis=1)[chosen], errors[chosen]
        print(case, fold, flush=True)


def fitted(evidence: NDArray[np.float64], errors: NDArray[np.float64]) -> list[float]:
    """Return weights w that maximize the likelihood of errors with means exp(evidence @ w).

    Quasi-Poisson regression by Newton's method, with a small ridge on standardized evidence.
    """
    mean, deviation = evidence.mean(axis=0), evidence.std(axis=0) + 1e-9
    mean[0], deviation[0] = 0, 1
    standard = (evidence - mean) / deviation
    weights = np.zeros(evidence.shape[1])
    weights[0] = np.log(errors.mean())
    ridge = _RIDGE * np.eye(len(weights))
    ridge[0, 0] = 0
    for _ in range(_STEPS):
        means = np.exp((standard @ weights).clip(-8, 0))
        scale = len(errors) * errors.mean()
        slope = standard.T @ (means - errors) / scale + ridge @ weights
        curvature = (standard * means[:, None]).T @ standard / scale + ridge
        weights -= 0.7 * np.linalg.solve(curvature, slope)
    result = weights / deviation
    result[0] -= (mean / deviation * weights)[1:].sum()
    return [round(float(value), 3) for value in result]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write-docs", action="store_true", help="also write the tables")
    parser.add_argument(
        "--fit", action="store_true", help="fit the weights of `calibrated` instead"
    )
    parser.add_argument("--seeds", type=int, default=len(SEEDS), help="number of seeds")
    arguments = parser.parse_args()
    if arguments.fit:
        evidence, errors = zip(*left_out(), strict=True)
        print(Evidence(*fitted(np.concatenate(evidence), np.concatenate(errors))))
        return
    known = {(record["case"], record["seed"]) for record in recorded()}
    for seed, case in product(SEEDS[: arguments.seeds], CASES):
        if (case, seed) not in known:
            append(measured(case, seed), FILE)
            print(case, seed, flush=True)
    records = recorded()
    print(tables(records))
    if arguments.write_docs:
        pages.rewrite(
            pages.DOCS / "confidence.md", pages.marks("bench-confidence"), summary(records)
        )
        pages.write_tables("confidence", "Confidence", "bench-confidence", tables(records))


if __name__ == "__main__":
    main()
