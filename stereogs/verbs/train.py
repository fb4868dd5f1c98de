"""The verbs `train` and `resume`."""

from __future__ import annotations

import argparse
import gc
import json
import sys
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

from registry.errors import RunError
from registry.toolkit.progress.display import showing

from ..command_line.arguments import (
    add_accept_changed,
    add_changes,
    add_device,
    add_run,
    add_run_options,
    run_options,
)
from ..command_line.command import Command, TrainRequest
from ..command_line.installed import train_options
from ..command_line.output import conclude, console
from ..quality.option import add_quality, given_fit
from ..quality.table import SHORT

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from registry.discovery import Plugins
    from registry.pipeline.pipeline import Pipeline


class Train(Command):
    """Train a scene with a pipeline."""

    epilog = """\
examples:
  stereogs train my-photos                           a folder of pictures or data
  stereogs train my-photos --quality best            the best pipeline without networks
  stereogs train my-photos --seconds 30              finish within thirty seconds
  stereogs train clip.mp4                            twelve frames of a video
  stereogs train 3dgs --scene my-photos              a ready pipeline, by name
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
            type=Path,
            metavar="PIPELINE",
            help="a YAML file, the name of a ready pipeline, or data, for which a pipeline is chosen: a "
            "folder of photographs or of a data set, or a video",
        )
        parser.add_argument(
            "--out",
            type=Path,
            metavar="DIR",
            help="the run folder, new or empty, or its address, s3://BUCKET/RUN (default: "
            "runs/<pipeline>-<scene>, numbered if taken)",
        )
        parser.add_argument(
            "--scene",
            type=Path,
            metavar="DIR",
            help="a folder of photographs or data, instead of the pipeline's scene",
        )
        add_changes(parser)
        add_device(parser)
        add_run_options(parser, "train")
        add_quality(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Train; return 0, or 1 if something failed after training, or 130 after Ctrl-C."""
        begin = monotonic()
        from registry.calls.watchdog import WATCHDOG

        output = console()
        with WATCHDOG.ending(arguments.hang_after), showing(output):
            from registry.discovery import Plugins
            from registry.runs.folder import in_runs

            from ..session import train

            plugins, place = Plugins(), arguments.out or in_runs
            named = not _is_data(arguments.pipeline, plugins)
            load = _loader(arguments, plugins, named)
            pipeline = load(arguments.pipeline.as_posix() if named else SHORT)
            request = TrainRequest(arguments, begin, load, pipeline_named=named)
            with collector_at_rest():
                import registry.runs.training_run  # noqa: F401
            with run_options(request, train_options("train"), output) as options:
                fit = given_fit(request)
                run = train(pipeline, options, out=place, fit=fit)
                status = conclude(run, output)
                for line in fit.closing(run) if run.finished else ():
                    output.print(line)
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
        add_accept_changed(parser, "plugins")
        add_run_options(parser, "resume")

    def run(self, arguments: argparse.Namespace) -> int:
        """Train to the end; return the exit status as `train` does."""
        request, output = TrainRequest(arguments, monotonic()), console()
        from registry.calls.watchdog import WATCHDOG

        with (
            WATCHDOG.ending(arguments.hang_after),
            showing(output),
            run_options(request, train_options("resume"), output) as options,
        ):
            from ..session import resume

            return conclude(resume(arguments.run_folder, options), output)


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


def _is_data(given: Path, plugins: Plugins) -> bool:
    """Return whether the argument of `train` names data: a folder, a URL, or a file but a pipeline's."""
    from registry.pipeline.ready import is_pipeline_file
    from registry.recognition import recognizing
    from registry.toolkit.cache.remote import url_of

    if is_pipeline_file(given):
        return False
    is_data = given.is_dir() or url_of(given) is not None
    return is_data or (given.is_file() and bool(given.suffix or recognizing(given, plugins)))


def _loader(
    arguments: argparse.Namespace, plugins: Plugins, named: bool
) -> Callable[[str], Pipeline]:
    """Return a function that loads a pipeline by name or path, with the changes of the command line.

    Raises:
        RunError: two scenes are given.
        SceneError: no pipeline is named, and no loader or several recognize the folder.
    """
    from registry.pipeline.pipeline import load_pipeline
    from registry.pipeline.settings_check import escape_variables
    from registry.recognition import recognize
    from registry.toolkit.cache.remote import url_of

    overrides = arguments.set
    if arguments.scene and not named:
        what = f"two scenes are given: {arguments.pipeline} and {arguments.scene}"
        raise RunError(what, where="the command line", fix="leave one of them out")
    if data := arguments.scene if named else arguments.pipeline:
        scene = {"path": escape_variables(url_of(data) or str(data))}
        if not any(text.partition("=")[0].strip() == "scene.use" for text in overrides):
            scene["use"] = recognize(data, plugins).use
        overrides = [f"scene={json.dumps(scene, ensure_ascii=False)}", *overrides]

    def load(name: str) -> Pipeline:
        return load_pipeline(Path(name), plugins, overrides=overrides, disabled=arguments.disable)

    return load
