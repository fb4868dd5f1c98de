"""Score pipelines on held-out training views: `python -m benchmarks.left_out`.

The middle one of each three training views is held out; the pipeline trains on the others and is scored on
the held-out ones. Test views are not used, so settings may be chosen here. A variant is a line of
overrides, as for `--set`:

    python -m benchmarks.left_out plain "more dropout: modifiers.dropout.rate=0.3"

prints the gain of each variant over the first. Records are kept in `benchmarks/out/left_out.jsonl`; a
recorded pipeline is not trained again. Changes of the code are not detected; remove the file after one.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from statistics import fmean
from time import process_time

from benchmarks.left_out_scenes import OVERRIDES, half, thinned
from benchmarks.records import append, lines
from benchmarks.trainings import PIPELINES
from core_rasterizer import Device, open_device
from registry import PointCloud, RunError, Scene
from registry.calls.process_state import one_torch_thread
from registry.pipeline.parts import Parts
from registry.pipeline.pipeline import Pipeline
from registry.runs.evaluation import evaluate
from registry.training.assembly import assemble
from stereogs.experiments.planning.plan import pipeline_digest
from stereogs.experiments.showing.score_table import markdown
from stereogs.session import build_pipeline, load_scene

OUT = Path(__file__).parent / "out" / "left_out.jsonl"
DEFAULT_CASES = "llff_fern-6,llff_flower-6,dtu_scan24-6,dtu_scan65-6"


@dataclass(frozen=True)
class Variant:
    """A name and overrides as for `--set`."""

    name: str
    overrides: tuple[str, ...]

    @classmethod
    def parse(cls, text: str) -> Variant:
        """Read "name" or "name: one=1; two=2"."""
        name, _, overrides = text.partition(":")
        return cls(name.strip(), tuple(part.strip() for part in overrides.split(";") if part))


@dataclass(frozen=True)
class VariantScore:
    """One training.

    Args:
        case: Data set and number of training views before some are held out.
        changes: "half" for photographs of half size, otherwise empty.
        digest: Digest of the pipeline.
        seed: Seed of the training.
        psnr: Mean over the held-out views, dB.
        ssim: Mean over the held-out views.
        train_psnr: Mean over the views trained on, dB.
        gaussians: Number at the end.
        initial_cpu_seconds: Depth and first points; about 0 if an earlier trial of this process made them.
        cpu_seconds: CPU seconds of the training, all threads.
    """

    case: str
    changes: str
    digest: str
    seed: int
    psnr: float
    ssim: float
    train_psnr: float
    gaussians: int
    initial_cpu_seconds: float
    cpu_seconds: float


@dataclass(eq=False)
class VariantTrainings:
    """Trains variants of pipelines; loads shared scenes and computes shared first points once.

    Args:
        device: Device of the trainings.
        halved: Whether photographs have half their size, for a quarter of the time.
    """

    device: Device
    halved: bool = False

    def __post_init__(self) -> None:
        self._points: dict[str, PointCloud] = {}
        self._scene = cache(self._load)

    @property
    def changes(self) -> str:
        """The changes of the scenes, for records."""
        return "half" if self.halved else ""

    @one_torch_thread()
    def trial(self, case: str, pipeline: Pipeline) -> VariantScore:
        """Train one pipeline on one case."""
        scene = self._scene(case).in_frame()
        pipeline = pipeline.for_views(len(scene.train))
        settings = pipeline.training
        parts = Parts(pipeline, self.device)
        begin = process_time()
        points = self._first_points(case, pipeline, parts, scene)
        had_points = process_time()
        trainer = assemble(parts, scene, points)
        for _ in trainer.run():
            pass
        model = trainer.model
        trained = process_time()
        test = evaluate(model, scene, scene.test, parts["metrics"]).mean
        train = evaluate(model, scene, scene.train, parts["metrics"]).mean
        return VariantScore(
            case=case,
            changes=self.changes,
            digest=pipeline_digest(pipeline),
            seed=settings.seed,
            psnr=_number(test["psnr"]),
            ssim=_number(test["ssim"]),
            train_psnr=_number(train["psnr"]),
            gaussians=model.count,
            initial_cpu_seconds=round(had_points - begin, 1),
            cpu_seconds=round(trained - had_points, 1),
        )

    def _load(self, case: str) -> Scene:
        pipeline = build_pipeline(PIPELINES / "weightfree_fast.yaml", OVERRIDES[case])
        scene = thinned(load_scene(pipeline, device=self.device))
        return half(scene) if self.halved else scene

    def _first_points(
        self, case: str, pipeline: Pipeline, parts: Parts, scene: Scene
    ) -> PointCloud:
        items = (*pipeline.items["initializer"], *pipeline.items["priors"])
        settings = [item.settings.model_dump_json() for item in items]
        key = json.dumps([case, [item.offer.name for item in items], settings])
        if key not in self._points:
            initializer = parts.one("initializer").component
            self._points[key] = initializer.initialize(scene.for_training(), parts.priors)
        return self._points[key]


def _number(score: float | None) -> float:
    if score is None:
        raise RunError("a view has no score", fix="choose a case whose views have one")
    return round(score, 4)


def measure(
    bench: VariantTrainings,
    pipeline: Path,
    variants: Sequence[Variant],
    cases: Sequence[str],
    seeds: int,
) -> Iterator[tuple[Variant, VariantScore]]:
    """Yield every variant on every case with every seed; train those without a record."""
    records = (VariantScore(**values) for values in lines(OUT))
    known = {(record.case, record.changes, record.digest): record for record in records}
    for case in cases:
        for seed in range(seeds):
            for variant in variants:
                overrides = [*variant.overrides, f"training.seed={seed}"]
                built = build_pipeline(pipeline, overrides)
                key = (case, bench.changes, pipeline_digest(built))
                if key not in known:
                    known[key] = bench.trial(case, built)
                    append(asdict(known[key]), OUT)
                yield variant, known[key]


def table(results: Sequence[tuple[Variant, VariantScore]], variants: Sequence[Variant]) -> str:
    """Return means of each variant and its gain over the first, on the same cases and seeds."""
    headings = ["variant", "PSNR", "SSIM", "gain dB, mean", "by case", "training views", "CPU s"]
    cells = []
    rows = {v.name: [r for one, r in results if one == v] for v in variants}
    first = rows[variants[0].name]
    for name, records in rows.items():
        gains = [a.psnr - b.psnr for a, b in zip(records, first, strict=True)]
        cases = dict.fromkeys(record.case for record in records)
        by_case = [
            fmean(g for g, r in zip(gains, records, strict=True) if r.case == case)
            for case in cases
        ]
        cells.append(
            [
                name,
                f"{fmean(r.psnr for r in records):.2f}",
                f"{fmean(r.ssim for r in records):.4f}",
                f"{fmean(gains):+.3f}",
                " ".join(f"{gain:+.2f}" for gain in by_case),
                f"{fmean(r.train_psnr for r in records):.2f}",
                f"{fmean(r.cpu_seconds for r in records):.1f}",
                f"{fmean(r.gaussians for r in records):,.0f}",
            ]
        )
    return markdown([*headings, "Gaussians"], cells)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("variants", nargs="+", type=Variant.parse, help='"name: one=1; two=2"')
    parser.add_argument("--pipeline", type=Path, default=PIPELINES / "weightfree_fast.yaml")
    parser.add_argument(
        "--cases", default=DEFAULT_CASES, help="separated by commas; of: " + ", ".join(OVERRIDES)
    )
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds")
    parser.add_argument("--half", action="store_true", help="photographs of half their size")
    arguments = parser.parse_args()
    bench, results = VariantTrainings(open_device(), arguments.half), []
    cases = arguments.cases.split(",")
    for variant, record in measure(
        bench, arguments.pipeline, arguments.variants, cases, arguments.seeds
    ):
        print(f"{record.case} seed {record.seed} {variant.name}: {record}", flush=True)
        results.append((variant, record))
    print(table(results, arguments.variants))
    return 0


if __name__ == "__main__":
    sys.exit(main())
