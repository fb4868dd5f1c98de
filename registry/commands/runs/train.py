"""`stereogs train`: a pipeline in, a run folder out."""

from __future__ import annotations

import argparse
import json
from functools import partial
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from ...choosing.table import QUALITIES, SHORT
from ...errors import RunError
from ..output import (
    Verbs,
    add_device,
    add_verb,
    add_watching,
    console,
    error_console,
    positive_seconds,
    watching,
)
from .live_page import live_page

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.console import Console

    from ...pipeline.pipeline import Pipeline
    from ...plugins.discovery import Plugins
    from ...runs.beginning import Fit
    from ...runs.run import Run

FAILED = 1
"""Exit status of a run that is finished, but a metric, an exporter or a report failed."""
INTERRUPTED = 130
LENGTH = "training.iterations"

_EPILOG = """\
examples:
  stereogs train my-photos                           a folder of pictures or data
  stereogs train my-photos --quality best            the best there is without networks
  stereogs train my-photos --seconds 30              as good as thirty seconds allow
  stereogs train 3dgs --set scene.path=my-photos     a ready pipeline, by name
  stereogs train my.yaml --set training.iterations=5000
  stereogs train 3dgs --disable opacity_reset --out runs/without-reset
  stereogs train my-photos --view                    and look while it trains (extra `viewer`)

A folder is read by the loader that knows it by its content (see `stereogs check`), with that
loader's defaults and what --set scene.SETTING=VALUE says; the pipeline is chosen, and the run says which
and why. --seconds counts everything from the command to the last file. Iterations are measured on the
scene before the first one; the number chosen stands in RUN/pipeline.yaml, which repeats the run, bit by
bit on the same device.
Ctrl-C or SIGTERM stops after the current iteration and leaves a checkpoint; `stereogs resume` goes on
from it to the same result.
"""


def add(verbs: Verbs) -> None:
    """Add the verb."""
    parser = add_verb(verbs, "train", "train a scene as a pipeline says", _EPILOG)
    parser.add_argument(
        "pipeline",
        nargs="?",
        type=Path,
        metavar="PIPELINE",
        help="a YAML file, the name of a ready one, or a folder of pictures or data, for which a "
        "pipeline is chosen",
    )
    length = parser.add_mutually_exclusive_group()
    length.add_argument(
        "--seconds",
        type=positive_seconds,
        metavar="N",
        help="keep the whole run within so many seconds; never more iterations than the pipeline says",
    )
    length.add_argument(
        "--quality",
        choices=QUALITIES,
        help="how much time a folder is worth (default: good)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="the run folder, new or empty (default: runs/<pipeline>-<scene>, numbered if taken)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="A.B=VALUE",
        help="change a setting; items of lists go by name: regularizers.stereo_depth.weight=2",
    )
    parser.add_argument(
        "--disable",
        action="append",
        default=[],
        metavar="NAME",
        help="switch a component off",
    )
    add_device(parser)
    add_watching(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Train; 0 at the end, 1 if something failed after training, 130 after Ctrl-C."""
    begin = monotonic()
    from ...calls.watchdog import WATCHDOG
    from ...plugins.discovery import Plugins
    from ...session import train
    from ...system.loading import collector_at_rest

    output = console()
    _check(arguments)
    with WATCHDOG.ending(arguments.hang_after):
        load = _loader(arguments, Plugins())
        named = None if arguments.pipeline.is_dir() else arguments.pipeline.as_posix()
        pipeline = load(named or SHORT)
    with collector_at_rest():
        from ...runs.training_run import in_runs

    with live_page(arguments.view, output) as page:
        run = train(
            pipeline,
            out=arguments.out or in_runs,
            progress=output,
            device=arguments.device,
            fit=_fit(arguments, begin, load, output, named=named is not None),
            **watching(arguments),
            **page,
        )
        status = conclude(run, output)
        if run.finished and (named is None or arguments.seconds):
            took = f"; it took {monotonic() - begin:.1f} s" if arguments.seconds else ""
            output.print(f"repeat    stereogs train {run.folder_or_refuse().pipeline}{took}")
        return status


def _check(arguments: argparse.Namespace) -> None:
    """Refuse what cannot be meant, before anything is looked up."""
    if arguments.pipeline is None:
        raise RunError(
            "there is nothing to train",
            where="the command line",
            fix="give a folder of photographs, or a pipeline, for example 3dgs",
        )
    if arguments.quality and not arguments.pipeline.is_dir():
        raise RunError(
            f"{arguments.pipeline} is a pipeline, which has a quality of its own",
            where=f"--quality {arguments.quality}",
            fix="give a folder of photographs or data, or --seconds",
        )
    if (arguments.seconds or arguments.quality) and _iterations_given(arguments):
        option = "--seconds" if arguments.seconds else "--quality"
        raise RunError(
            f"the length of the run is said twice: by {option} and in iterations",
            where=f"--set {LENGTH}=...",
            fix="leave one of them out",
        )


def _iterations_given(arguments: argparse.Namespace) -> bool:
    return any(text.partition("=")[0].strip() == LENGTH for text in arguments.set)


def _loader(arguments: argparse.Namespace, plugins: Plugins) -> Callable[[str], Pipeline]:
    """What loads a pipeline, by name or path, for the scene and with the changes that are given."""
    from ...pipeline.pipeline import load_pipeline

    overrides, folder = arguments.set, arguments.pipeline
    if folder.is_dir():
        overrides = [_scene(folder, plugins, overrides), *overrides]

    def load(name: str) -> Pipeline:
        return load_pipeline(Path(name), plugins, overrides=overrides, disabled=arguments.disable)

    return load


def _fit(
    arguments: argparse.Namespace,
    begin: float,
    load: Callable[[str], Pipeline],
    output: Console,
    *,
    named: bool,
) -> Fit | None:
    """What chooses the pipeline, or its length; None where both are said."""
    from ...choosing.fitting import Budget, choose, fit_length

    budget = Budget(arguments.seconds, begin) if arguments.seconds else None
    if _iterations_given(arguments):
        return None
    if named:
        return partial(fit_length, budget=budget, say=output.print) if budget else None
    return partial(
        choose, wanted=budget or arguments.quality or "good", load=load, say=output.print
    )


def _scene(folder: Path, plugins: Plugins, overrides: Sequence[str]) -> str:
    """The override that makes a folder the scene, read by the loader that knows it or is asked for.

    Raises:
        SceneError: none or several know it.
    """
    from ...pipeline.settings_check import escape_variables
    from ...plugins.recognition import recognize

    scene = {"path": escape_variables(str(folder))}
    if not any(text.partition("=")[0].strip() == "scene.use" for text in overrides):
        scene["use"] = recognize(folder, plugins).name
    return f"scene={json.dumps(scene)}"


def conclude(run: Run, output: Console) -> int:
    """Tell how the run ended and where its files lie; returns the exit status."""
    from ...comparing.run_table import results_table
    from ...runs.results import RENDERS

    folder = run.folder_or_refuse()
    if not run.finished:
        output.print(
            f"stopped; the checkpoint is complete. Go on with\n  stereogs resume {folder.path}"
        )
        return INTERRUPTED
    results: dict[str, Any] = folder.results()
    output.print(results_table(results), soft_wrap=False)
    memory = results["peak_memory_mb"]
    output.print(
        f"{results['gaussians']:,} Gaussians, {results['iterations']:,} iterations in "
        f"{results['seconds']:.0f} s ({results['iterations_per_second']:.1f} it/s)"
        + (f", at most {memory:.0f} MB" if memory is not None else "")
    )
    for file in results["exports"]:
        output.print(f"exported  {folder.path / file}")
    if results["test"]:
        output.print(f"pictures  {folder.path / RENDERS}")
    for file in results["reports"]:
        output.print(f"page      {folder.path / file}")
    output.print(f"hash      {results['hash']}")
    return tell_failures(results, folder.path)


def tell_failures(results: dict[str, Any], folder: Path) -> int:
    """Tell which metrics, exporters and reports failed; returns the exit status."""
    failures = results["failures"]
    output = error_console()
    for failure in failures:
        output.print(f"stereogs: {failure['component']}: {failure['what']}")
        output.print(f"  where  {failure['where']}")
    if failures:
        output.print(
            "What did not fail is kept. Once it is mended, this scores, exports and reports again:\n"
            f"  stereogs eval {folder}"
        )
    return FAILED if failures else 0
