"""The verbs `train`, `resume` and `eval`."""

from __future__ import annotations

import argparse
import gc
import json
import sys
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

from ..contract.command import Command, TrainOption, TrainRequest
from ..errors import RunError
from ..plugins.commands import train_options
from .arguments import (
    add_accept_changed_plugins,
    add_changes,
    add_device,
    add_run,
    add_run_options,
    open_given,
    run_options,
)
from .output import conclude, console, print_failures, results_table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from ..pipeline.pipeline import Pipeline
    from ..plugins.discovery import Plugins


class Train(Command):
    """Train a scene with a pipeline."""

    epilog = """\
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

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
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
        add_changes(parser)
        add_device(parser)
        add_run_options(parser, "train")

    def run(self, arguments: argparse.Namespace) -> int:
        """Train; return 0, or 1 if something failed after training, or 130 after Ctrl-C."""
        begin = monotonic()
        from ..calls.watchdog import WATCHDOG
        from ..plugins.discovery import Plugins
        from ..session import train

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

            with run_options(request, extra, output) as options:
                run = train(pipeline, options=options, out=arguments.out or in_runs)
                status = conclude(run, output)
                if run.finished and options.fit is not None:
                    output.print(
                        f"repeat    stereogs train {run.folder_or_refuse().pipeline}; "
                        f"it took {monotonic() - begin:.1f} s"
                    )
        return status


class Resume(Command):
    """Continue a run that was stopped."""

    epilog = """\
examples:
  stereogs resume runs/3dgs-fern

Continues from the newest intact checkpoint, to the same result as if the run had never stopped: after Ctrl-C,
a kill, a crash or a full disk. A finished run is scored and exported again.
"""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add_run(parser)
        add_accept_changed_plugins(parser)
        add_run_options(parser, "resume")

    def run(self, arguments: argparse.Namespace) -> int:
        """Train to the end; return the exit status as `train` does."""
        request = TrainRequest(arguments, monotonic())
        from ..calls.watchdog import WATCHDOG
        from ..session import resume

        output = console()
        with (
            WATCHDOG.ending(arguments.hang_after),
            run_options(request, train_options("resume"), output) as options,
        ):
            return conclude(resume(arguments.run_folder, options), output)


class Eval(Command):
    """Score a run's views again, from its checkpoint."""

    epilog = """\
examples:
  stereogs eval runs/3dgs-fern

Renders the training and test views from the newest checkpoint, renews the scores in results.json and
the pictures, and prints the table. For a finished run it also renews exports and reports. A run that was
stopped is scored at its checkpoint.
"""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add_run(parser)
        add_accept_changed_plugins(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Evaluate and print."""
        run = open_given(arguments)
        from ..runs.results import RENDERS

        accept = arguments.accept_changed_plugins
        output, results = console(), run.renew(accept_changed_plugins=accept)
        output.print(results_table(results), soft_wrap=False)
        if run.scene.test:
            output.print(f"pictures  {run.folder_or_refuse().path / RENDERS}")
        return print_failures(results["failures"], arguments.run_folder)


@contextmanager
def collector_at_rest() -> Iterator[None]:
    """Import packages within the block without garbage collection.

    torch makes a quarter of a million objects that stay; collections during its import take an eighth of the
    time. If the block imported modules, later collections skip all objects that exist then (`gc.freeze`).
    """
    enabled, modules = gc.isenabled(), len(sys.modules)
    gc.disable()
    try:
        yield
    finally:
        if len(sys.modules) > modules:
            gc.freeze()
        if enabled:
            gc.enable()


def _folder_pipeline(options: Sequence[TrainOption]) -> str:
    """Return the pipeline for a folder of photographs when the command names none."""
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
    from ..plugins.discovery import recognize

    scene = {"path": escape_variables(str(folder))}
    if not any(text.partition("=")[0].strip() == "scene.use" for text in overrides):
        scene["use"] = recognize(folder, plugins).name
    return f"scene={json.dumps(scene)}"
