"""`stereogs ablate`: a pipeline with parts on and off and settings varied, as one table."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import RunError
from .output import Verbs, add_device, add_verb, console

if TYPE_CHECKING:
    from rich.console import Console

    from ..ablation.planning.plan import Plan
    from ..ablation.running.folder import AblationFolder
    from ..ablation.running.runner import Outcome
    from ..ablation.showing.scores import Results

INTERRUPTED = 130

_EPILOG = """\
examples:
  stereogs ablate pipelines/demo.yaml --vary densification.gradient_threshold=1e-4,2e-4,4e-4
  stereogs ablate pipelines/stereogs.yaml --toggle initializer,stereo_depth,opacity
  stereogs ablate pipelines/ablations/parts.yaml --scenes llff_fern,llff_flower --seeds 3

On is what the pipeline says. Off: a component is disabled, unless it names what it takes the place of;
so decays of opacity give way to 3DGS's periodic reset. An ablation file may say otherwise.

Runs that are finished are found by their pipeline and not trained again: the same command goes on
where it was stopped. It writes ablation.txt, ablation.csv and index.html.
"""


def add(verbs: Verbs) -> None:
    """Add the verb."""
    parser = add_verb(
        verbs, "ablate", "train with parts on and off, and settings varied; one table", _EPILOG
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="a pipeline or an ablation file")
    parser.add_argument(
        "--toggle", metavar="A,B", help="what to switch on and off: sections or names of components"
    )
    parser.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="A.B=V,V",
        help="values of a setting; repeat for several settings",
    )
    parser.add_argument(
        "--scenes", metavar="A,B", help="folders in STEREOGS_DATA, or paths (with a slash)"
    )
    parser.add_argument(
        "--seeds", type=int, metavar="N", help="train with so many seeds (default 1)"
    )
    parser.add_argument(
        "--pipeline", type=Path, metavar="FILE", help="in place of an ablation file's own pipeline"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="A.B=VALUE",
        help="change a setting of the pipeline, as for train",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="where to write (default: runs/ablation-<file>)"
    )
    parser.add_argument(
        "--jobs",
        type=int,
        metavar="N",
        help="trainings at the same time (default: as cores and memory allow; 1 on a GPU)",
    )
    add_device(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Train what is missing, then write and print the table; 130 after Ctrl-C."""
    output = console()
    if arguments.jobs is not None and arguments.jobs < 1:
        raise RunError(
            f"{arguments.jobs} trainings at the same time are too few",
            where="--jobs",
            fix="give 1 or more, or leave it out",
        )
    plan = _plan(arguments)
    from core_rasterizer import open_device

    from ..ablation.running.folder import AblationFolder
    from ..ablation.running.jobs import default_jobs
    from ..ablation.running.runner import train_all

    device = open_device(arguments.device)
    folder = AblationFolder(arguments.out or Path("runs", f"ablation-{plan.name}"))
    with folder.locked() as lock:
        results = {run: folder.results(run) for run in plan.runs}
        waiting = [run for run in plan.runs if not results[run]]
        peaks = (found.get("peak_memory_mb") or 0.0 for found in results.values() if found)
        jobs = arguments.jobs or default_jobs(device, peaks)
        output.print(
            f"{plan.size}, {len(plan.runs) - len(waiting)} of them finished; {jobs} at a time "
            f"on {device.name}; writing {folder.path}"
        )
        outcome = train_all(
            waiting, folder, jobs=jobs, device=arguments.device, lock=lock, console=output
        )
        results = {run: folder.results(run) for run in plan.runs}
        _write(plan, results, folder)
    return _conclude(plan, results, folder, outcome, output)


def _plan(arguments: argparse.Namespace) -> Plan:
    from ..ablation.planning.arguments import with_arguments
    from ..ablation.planning.description import read_description
    from ..ablation.planning.making import make_plan
    from ..plugins.discovery import Plugins

    description = with_arguments(
        read_description(arguments.file, arguments.pipeline),
        overrides=arguments.set,
        toggles=arguments.toggle,
        vary=arguments.vary,
        scenes=arguments.scenes,
        seeds=arguments.seeds,
    )
    return make_plan(description, Plugins())


def _write(plan: Plan, results: Results, folder: AblationFolder) -> None:
    from ..ablation.showing.page import as_page
    from ..ablation.showing.table import as_csv, as_text
    from ..system.files import write_text

    write_text(folder.path / "ablation.txt", as_text(plan, results))
    write_text(folder.path / "ablation.csv", as_csv(plan, results, folder))
    write_text(folder.path / "index.html", as_page(plan, results, folder))


def _conclude(
    plan: Plan, results: Results, folder: AblationFolder, outcome: Outcome, output: Console
) -> int:
    """Print the table and how it ended; returns the exit status."""
    from ..ablation.showing.table import as_text

    output.print(as_text(plan, results), end="")
    for name in ("ablation.txt", "ablation.csv", "index.html"):
        output.print(f"written  {folder.path / name}")
    if outcome.stopped:
        finished = sum(bool(found) for found in results.values())
        output.print(
            f"stopped; {finished} of {len(plan.runs)} runs are finished. "
            "The same command goes on from here."
        )
        return INTERRUPTED
    if outcome.failures:
        first, said = next(iter(outcome.failures.items()))
        raise RunError(
            f"{len(outcome.failures)} of {len(plan.runs)} runs failed; the first one said:\n{said}",
            where=str(folder.run(first).path.with_name(f"{folder.run(first).path.name}.log")),
            fix="mend the cause; the same command then trains what is missing",
        )
    return 0
