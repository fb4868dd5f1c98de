"""Train a scene with a pipeline."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from ..contract.command import Command, TrainOption, TrainRequest
from ..errors import RunError
from ..plugins.commands import train_options
from .output import add_device, console, error_console
from .run_options import add_run_options, given_options, running

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.console import Console

    from ..pipeline.pipeline import Pipeline
    from ..plugins.discovery import Plugins
    from ..runs.run import Run

FAILED = 1
"""Exit status if a metric, an exporter or a report failed after training."""
INTERRUPTED = 130

_EPILOG = """\
examples:
  stereogs train my-photos                           a folder of pictures or data
  stereogs train my-photos --quality best            the best pipeline without networks
  stereogs train my-photos --seconds 30              finish within thirty seconds
  stereogs train 3dgs --set scene.path=my-photos     a ready pipeline, by name
  stereogs train my.yaml --set training.iterations=5000
  stereogs train 3dgs --disable opacity_reset --out runs/without-reset
  stereogs train my-photos --view                    show the scene meanwhile (extra `viewer`)

A folder is read by the loader that recognizes its content (see `stereogs check`), with that loader's
defaults and --set scene.SETTING=VALUE. The run reports which pipeline was chosen and why.
Ctrl-C or SIGTERM stops after the current iteration and saves a checkpoint; `stereogs resume` continues
from it to the same result.
"""


class Train(Command):
    """The verb `train`."""

    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments, and those of train options."""
        parser.add_argument(
            "pipeline",
            nargs="?",
            type=Path,
            metavar="PIPELINE",
            help="a YAML file, the name of a ready pipeline, or a folder of photographs or data, for "
            "which a pipeline is chosen",
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
            help="change a setting; list items go by name: regularizers.stereo_depth.weight=2",
        )
        parser.add_argument(
            "--disable",
            action="append",
            default=[],
            metavar="NAME",
            help="switch a component off",
        )
        add_device(parser)
        add_run_options(parser, "train")

    def run(self, arguments: argparse.Namespace) -> int:
        """Train; return 0, or 1 if something failed after training, or 130 after Ctrl-C."""
        begin = monotonic()
        from ..calls.watchdog import WATCHDOG
        from ..plugins.discovery import Plugins
        from ..session import train
        from ..system.loading import collector_at_rest

        output, extra = console(), train_options("train")
        for option in extra:
            option.check(arguments)
        with WATCHDOG.ending(arguments.hang_after):
            load = _loader(arguments, Plugins())
            is_folder = arguments.pipeline.is_dir()
            pipeline = load(_folder_pipeline(extra) if is_folder else arguments.pipeline.as_posix())
            request = TrainRequest(arguments, begin, load, pipeline_named=not is_folder)
            with collector_at_rest():
                from ..runs.training_run import in_runs

            with running(extra, request, given_options(arguments, output)) as options:
                run = train(pipeline, options=options, out=arguments.out or in_runs)
                status = conclude(run, output)
                if run.finished and options.fit is not None:
                    output.print(
                        f"repeat    stereogs train {run.folder_or_refuse().pipeline}; "
                        f"it took {monotonic() - begin:.1f} s"
                    )
        return status


def _folder_pipeline(options: Sequence[TrainOption]) -> str:
    """The pipeline for a folder of photographs when the command names none."""
    for option in options:
        if option.folder_pipeline is not None:
            return option.folder_pipeline
    raise RunError(
        "no installed plugin chooses a pipeline for a folder",
        where="the command line",
        fix="name a pipeline: `stereogs train PIPELINE --set scene.path=FOLDER`",
    )


def _loader(arguments: argparse.Namespace, plugins: Plugins) -> Callable[[str], Pipeline]:
    """Return a function that loads a pipeline by name or path, with the changes of the command line."""
    from ..pipeline.pipeline import load_pipeline

    overrides, folder = arguments.set, arguments.pipeline
    if folder is None:
        raise RunError(
            "neither a pipeline nor a folder is given",
            where="the command line",
            fix="give a folder of photographs, or a pipeline, for example 3dgs",
        )
    if folder.is_dir():
        overrides = [_scene(folder, plugins, overrides), *overrides]

    def load(name: str) -> Pipeline:
        return load_pipeline(Path(name), plugins, overrides=overrides, disabled=arguments.disable)

    return load


def _scene(folder: Path, plugins: Plugins, overrides: Sequence[str]) -> str:
    """Return the override that makes a folder the scene; its loader recognizes it or is given with --set.

    Raises:
        SceneError: no loader or several recognize the folder.
    """
    from ..pipeline.settings_check import escape_variables
    from ..plugins.recognition import recognize

    scene = {"path": escape_variables(str(folder))}
    if not any(text.partition("=")[0].strip() == "scene.use" for text in overrides):
        scene["use"] = recognize(folder, plugins).name
    return f"scene={json.dumps(scene)}"


def conclude(run: Run, output: Console) -> int:
    """Print how the run ended and the paths of its files; return the exit status."""
    from ..runs.results import RENDERS
    from .run_table import results_table

    folder = run.folder_or_refuse()
    if not run.finished:
        output.print(
            f"stopped; the checkpoint is complete. Continue with\n  stereogs resume {folder.path}"
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
    return print_failures(results["failures"], folder.path)


def print_failures(failures: Sequence[dict[str, str]], folder: Path) -> int:
    """Print which metrics, exporters and reports failed; return the exit status."""
    output = error_console()
    for failure in failures:
        output.print(f"stereogs: {failure['component']}: {failure['what']}")
        output.print(f"  where  {failure['where']}")
    if failures:
        output.print(
            "All other results are saved. After fixing it, score, export and report again:\n"
            f"  stereogs eval {folder}"
        )
    return FAILED if failures else 0
