"""The `stereogs` command.

Help, the version and usage errors do not import torch: only the given verb is imported, and its `run` imports
the rest.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import logging
import os
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any

from core_rasterizer.errors import ExplainedError
from registry.calls.process_state import one_torch_thread
from registry.errors import PluginError
from registry.messages.suggestions import did_you_mean, listing
from registry.messages.terminal import CommandParser, HelpFormatter
from registry.system.memory import FREE_MEMORY, out_of_memory

from .command_line.arguments import add_verb
from .command_line.installed import verbs
from .command_line.output import INTERRUPTED, LogLines, console

USAGE_ERROR = 2
TRACE = "STEREOGS_TRACE"
"""Environment variable: 1 shows the Python traceback of every error."""

COMPLETING = "_ARGCOMPLETE"
"""Environment variable that a shell sets to request completions of a command line."""
PIPELINE_ARGUMENTS = ("pipeline", "file", "data")
"""Arguments that take the name of a ready pipeline, for completion."""

PROGRESS = "stereogs"
"""Logger whose INFO lines are shown."""

_EPILOG = """\
examples:
  stereogs demo                       three photographs to a scored scene
  stereogs train FOLDER               train on a folder of photographs
  stereogs train 3dgs --set scene.path=FOLDER
                                      with a pipeline of your choice
  stereogs resume runs/NAME           after Ctrl-C, a kill or a crash
  stereogs VERB --help                more examples

environment:
  STEREOGS_DATA      folder of data sets, for pipelines that name it
  STEREOGS_MODELS    folder of model files, for pipelines and metrics
  STEREOGS_CACHE     keeps found cameras and depths; empty = nowhere
  STEREOGS_CACHE_MB  how many megabytes are kept there; unset = 5000
  STEREOGS_DEVICE    part of the name of the OpenCL device to use
  STEREOGS_PLUGINS   which plugins to load: unset = all, empty = none, or names
  STEREOGS_TRACE     1 = show the Python traceback of errors
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status.

    0 done; 1 a check found a fault; 2 an error was explained; 130 after Ctrl-C or SIGTERM.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    logging.basicConfig(level=logging.WARNING, handlers=[LogLines()], format="%(message)s")
    logging.getLogger(PROGRESS).setLevel(logging.INFO)
    try:
        if COMPLETING in os.environ:
            import argcomplete

            # The annotation of `default_completer` is too narrow.
            argcomplete.autocomplete(build_parser(None), default_completer=_completions)  # type: ignore[arg-type]
        if not given:
            build_parser(given).print_help()
            return 0
        if given[0] == "--version":
            print(f"stereogs {importlib.metadata.version('stereogs-plugins')}")
            return 0
        parsed = parse(given)
        status = _run(parsed, given[0])
        sys.stdout.flush()
    except ExplainedError as error:
        return _explain(error)
    except BrokenPipeError:
        # The reader, such as `head`, has ended; Python must not flush to it on exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        where = str(error.filename or "")
        what = f"a file operation failed: {error.strerror or error}"
        return _explain(ExplainedError(what, where=where, fix="check the path and the free space"))
    except KeyboardInterrupt as stop:
        notes = getattr(stop, "__notes__", ())
        console(stderr=True).print(" ".join(["stereogs: interrupted", *notes]))
        return INTERRUPTED
    return status


def _completions(prefix: str, action: argparse.Action, **_: Any) -> list[str]:
    """Return values of an argument for a shell's completion."""
    from argcomplete.completers import FilesCompleter

    if action.dest == "name":
        from registry.discovery import Plugins, offered_name

        return [name for e in Plugins().entries if (name := offered_name(e)).startswith(prefix)]
    found = [str(path) for path in FilesCompleter()(prefix)]
    if action.dest in PIPELINE_ARGUMENTS:
        from registry.pipeline.ready import ready_pipelines

        found += [name for name in ready_pipelines() if name.startswith(prefix)]
    return found


def _run(parsed: argparse.Namespace, verb: str) -> int:
    """Run the verb; attribute an unexplained error to the plugin that offers the verb."""
    try:
        with one_torch_thread() if parsed.command.computes else nullcontext():
            status: int = parsed.command.run(parsed)
    except (ExplainedError, OSError):
        raise
    except Exception as error:
        if out_of_memory(error):
            what = f"memory ran out: {type(error).__name__}: {error}"
            raise ExplainedError(what, where=f"stereogs {verb}", fix=FREE_MEMORY) from error
        raise PluginError(
            f"the verb {verb!r} failed: {type(error).__name__}: {error}",
            where=f"{verbs()[verb].owner}, module {type(parsed.command).__module__}",
            fix=f"{TRACE}=1 shows the traceback; report it to the authors of the package",
        ) from error
    return status


def parse(given: Sequence[str]) -> argparse.Namespace:
    """Parse a command line; `command` of the result is the verb's `Command`.

    Raises:
        ExplainedError: the command line is wrong, or the plugin that offers its verb cannot be imported.
    """
    return build_parser(given).parse_args(list(given))


def build_parser(given: Sequence[str] | None) -> argparse.ArgumentParser:
    """Return the parser of the given verb, or one that lists all verbs.

    Args:
        given: the command line; None adds the arguments of every verb.

    Raises:
        ExplainedError: no verb has the given name, or two plugins offer the same one.
    """
    parser = CommandParser(
        prog="stereogs",
        description="Three to eighty photographs become a 3D Gaussian scene.",
        epilog=_EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    actions, known = parser.add_subparsers(title="verbs", metavar="VERB", required=True), verbs()
    if given and not given[0].startswith("-") and given[0] not in known:
        raise ExplainedError(
            f"unknown verb {given[0]!r}{did_you_mean(given[0], known)}",
            where="the command line",
            fix=f"verbs: {listing(known)}; `stereogs --help` describes them",
        )
    chosen = list(known) if given is None else [name for name in given[:1] if name in known]
    for name in chosen:
        command = known[name].load()
        own = add_verb(actions, name, known[name].summary, command.epilog)
        command.add_arguments(own)
        own.set_defaults(command=command)
    if not chosen:
        for name in known:
            add_verb(actions, name, known[name].summary, "")
    return parser


def _explain(error: ExplainedError) -> int:
    if os.environ.get(TRACE) == "1":
        import traceback

        traceback.print_exception(error)
    console(stderr=True).print(f"stereogs: {error}")
    return USAGE_ERROR
