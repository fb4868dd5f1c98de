"""Time and PSNR of each shortcut of a pipeline: `make bench-skips`.

Trains `weightfree_fast` and one variant of it for each switch, on scenes of three kinds, with several seeds,
as `stereogs bench` does. Variants take turns (seed by seed, scene by scene), so a busy hour affects all of
them; time is CPU seconds of the whole process, which depend little on the machine's load. Finished runs are
kept. With `--write-docs` rewrites `benchmarks/tables/skips.md` and the summary and picture in
`docs/run_time.md`. A page with curves and renders is written to the folder of the runs.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from benchmarks import pages
from benchmarks.skips_picture import draw
from benchmarks.skips_table import Measured, rows, summary, table
from core_rasterizer import open_device
from core_rasterizer.errors import ExplainedError
from registry import RunError
from registry.discovery import Plugins
from registry.pipeline.pipeline import load_pipeline
from registry.pipeline.yaml_source import Node, parse
from registry.system.files import write_json, write_text
from registry.toolkit.cache.entries import FOLDER_VARIABLE
from stereogs.experiments.planning.matrix import Matrix, plan_of
from stereogs.experiments.planning.plan import Plan, PlannedRun
from stereogs.experiments.running.folder import AblationFolder
from stereogs.experiments.running.runner import choose_runner, train_all
from stereogs.experiments.showing.page import as_page
from stereogs.quality.table import SHORT

OUT = Path(__file__).parent / "out" / "skips"
TARGET = "bench-skips"
PAGE = pages.DOCS / "run_time.md"
PICTURE = "shortcuts.png"
CPU_SECONDS = "cpu_seconds.json"
INTERRUPTED = 130
SCENES = {
    "fern-3": "{use: llff, name: fern-3, path: '${STEREOGS_DATA}/llff_fern', train_views: 3}",
    "dtu24-6": "{use: dtu, name: dtu24-6, path: '${STEREOGS_DATA}/dtu_scan24', train_views: 6}",
    "lego-8": (
        "{use: blender, name: lego-8, path: '${STEREOGS_DATA}/blender_lego', "
        "train_ids: [2, 16, 26, 55, 73, 76, 86, 93], test_every: 8, background: white}"
    ),
}


class Switch(NamedTuple):
    """One shortcut.

    Args:
        label: Label in the table.
        length: Length of the run as a share of the pipeline's.
        overrides: Overrides as for `--set`.
        disabled: Components to switch off.
    """

    label: str
    length: float = 1.0
    overrides: tuple[str, ...] = ()
    disabled: tuple[str, ...] = ()


DEFAULT = "default"
SWITCHES = (
    Switch(DEFAULT),
    Switch("half as many iterations", length=0.5),
    Switch("twice as many iterations", length=2.0),
    Switch("no growth", disabled=("gradient_threshold",)),
    Switch("no decay", disabled=("gradient_aware_decay",)),
    Switch("no dropout, no scaling at the end", disabled=("dropout", "expected_opacity")),
    Switch("dropout without scaling at the end", disabled=("expected_opacity",)),
    Switch("colours without direction (SH degree 0)", overrides=("training.sh_degree=0",)),
    Switch("a point every 4th pixel, not every 3rd", overrides=("initializer.stride=4",)),
    Switch("no limit of size", disabled=("size_limit",)),
    Switch("no margin around the views", overrides=("initializer.margin=false",)),
    Switch("photographs of full size from the start", disabled=("resolution_schedule",)),
    Switch("L1 alone in the loss", overrides=("training.ssim_weight=0",)),
)


def variant(switch: Switch, iterations: int | None, plugins: Plugins) -> Node:
    """Return the pipeline with one switch, as a tree.

    Args:
        iterations: Number of iterations instead of the pipeline's; schedules are scaled to it.
    """
    overrides = ["scene=procedural", "metrics=[psnr, ssim]", "exporters=[]", "reports=[]"]
    pipeline = load_pipeline(
        Path(SHORT), plugins, overrides=[*overrides, *switch.overrides], disabled=switch.disabled
    )
    made = pipeline.scaled(round(switch.length * (iterations or pipeline.training.iterations)))
    each = pipeline.iterations_per_view
    if iterations is None and each is not None:
        made = replace(made, iterations_per_view=round(switch.length * each))
    return parse(made.to_yaml(), switch.label)


def make_plan(scenes: Sequence[str], seeds: int, iterations: int | None) -> Plan:
    """Return the checked plan of every switch on every scene with every seed."""
    plugins = Plugins()
    pipelines = {switch.label: variant(switch, iterations, plugins) for switch in SWITCHES}
    written = tuple(parse(SCENES[name], name) for name in scenes)
    return plan_of(Matrix("skips", pipelines, written, None, seeds, None), plugins)


def in_turns(plan: Plan) -> list[PlannedRun]:
    """Sort runs by seed, then by scene."""
    places = {scene: place for place, scene in enumerate(plan.scenes)}
    return sorted(plan.runs, key=lambda run: (run.seed, places[run.scene]))


def measure(plan: Plan, folder: AblationFolder, device: str | None, console: Console) -> bool:
    """Train the missing runs, one at a time; return True if all are finished.

    Raises:
        RunError: a run failed.
    """
    os.environ[FOLDER_VARIABLE] = ""  # cached answers would make a run look fast
    with folder.locked() as lock:
        for run in in_turns(plan):
            if folder.results(run) and (folder.run(run).path / CPU_SECONDS).is_file():
                continue
            runner = choose_runner(None, 1, Plugins(()), open_device(device))
            runner.component.lock = lock
            before = _cpu_seconds_of_children()
            outcome = train_all([run], folder, runner, device=device, console=console)
            if outcome.stopped:
                return False
            for message in outcome.failures.values():
                raise RunError(f"a run failed: {message}", where=run.name, fix="fix the cause")
            took = _cpu_seconds_of_children() - before
            write_json(folder.run(run).path / CPU_SECONDS, {"cpu_seconds": round(took, 2)})
    return True


def _cpu_seconds_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def read(plan: Plan, folder: AblationFolder) -> list[Measured]:
    """Return the measurements of the finished runs."""
    found = []
    for run in plan.runs:
        results, file = folder.results(run), folder.run(run).path / CPU_SECONDS
        if results and file.is_file():
            cpu = json.loads(file.read_text("utf-8"))["cpu_seconds"]
            (choice,) = (c for c in run.combination.choices if c is not None)
            test = results["test"]
            found.append(
                Measured(
                    choice.label,
                    run.scene,
                    run.seed,
                    cpu,
                    test["psnr"],
                    test["ssim"],
                    results["gaussians"],
                )
            )
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=[*SCENES])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--iterations", type=int, help="instead of the pipeline's number")
    parser.add_argument("--device", help="part of a device's name")
    parser.add_argument(
        "--out", type=Path, default=OUT, help="folder of the runs (default: %(default)s)"
    )
    parser.add_argument(
        "--write-docs", action="store_true", help="rewrite tables, summary and picture"
    )
    arguments = parser.parse_args()
    console = Console(markup=False, highlight=False, soft_wrap=True)
    try:
        plan = make_plan(arguments.scenes, arguments.seeds, arguments.iterations)
        folder = AblationFolder(arguments.out)
        whole = measure(plan, folder, arguments.device, console)
        results = {run: folder.results(run) for run in plan.runs}
        write_text(folder.path / "index.html", as_page(plan, results, folder))
        measured = read(plan, folder)
        found = rows(measured, DEFAULT)
        text = table(found)
        console.print(text)
        draw(measured, (PAGE.parent / "images" if arguments.write_docs else folder.path) / PICTURE)
        if arguments.write_docs:
            pages.write_tables("skips", "Shortcuts of weightfree_fast", TARGET, text)
            pages.rewrite(PAGE, pages.marks(TARGET), summary(found, DEFAULT))
    except ExplainedError as error:
        sys.exit(f"skips: {error}")
    if not whole:
        console.print("stopped; the same command continues")
    return 0 if whole else INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
