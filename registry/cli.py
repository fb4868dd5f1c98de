"""The `stereogs` command.

Everything here, and every verb's `add`, imports argparse alone: help, the version and mistakes are answered
at once. A verb imports what it works with in its `run`, torch only when nothing is left to refuse.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Sequence

from core_rasterizer.errors import ExplainedError

from .commands import (
    check,
    compare,
    completion,
    doctor,
    explain,
    plugins,
    priors,
    schema,
    view,
)
from .commands.batches import ablate, bench
from .commands.output import error_console
from .commands.runs import demo, evaluate, export, render, replay, report, resume, train
from .messages.command_parser import CommandParser
from .messages.help_text import HelpFormatter
from .messages.suggestions import did_you_mean, listing

USAGE_ERROR = 2
INTERRUPTED = 130
TRACE = "STEREOGS_TRACE"
"""Environment variable: 1 shows the Python traceback of every error."""

PROGRESS = "stereogs"
"""Logger whose INFO lines are shown: a component that takes long tells of it there."""

VERBS = {
    "check": check,
    "train": train,
    "resume": resume,
    "replay": replay,
    "eval": evaluate,
    "render": render,
    "view": view,
    "export": export,
    "report": report,
    "compare": compare,
    "ablate": ablate,
    "bench": bench,
    "explain": explain,
    "plugins": plugins,
    "priors": priors,
    "schema": schema,
    "doctor": doctor,
    "demo": demo,
    "completion": completion,
}

_EPILOG = """\
examples:
  stereogs demo                       three photographs to a scored scene
  stereogs check FOLDER               what is in a folder of photographs
  stereogs train FOLDER               train on it
  stereogs train 3dgs --set scene.path=FOLDER
                                      with a ready pipeline of your choice
  stereogs resume runs/NAME           after Ctrl-C, a kill or a crash
  stereogs eval runs/NAME             score it again
  stereogs compare runs/ONE runs/TWO  scores side by side
  stereogs render runs/NAME --path    a flight between the training views
  stereogs view runs/NAME             the scene in the browser
  stereogs export runs/NAME --format gltf
                                      for other programs
  stereogs report runs/NAME           a page about a run, with the scene in 3D
  stereogs ablate ablations/parts     with parts on and off
  stereogs bench MATRIX.yaml          several pipelines on several scenes
  stereogs explain 3dgs               what runs when, and what it needs
  stereogs plugins                    what a pipeline can name
  stereogs priors check FILE.onnx     how to run a network, and how good it is

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
    """Run the command line; returns the exit status.

    0 done; 1 a check found a fault; 2 something is wrong and was explained; 130 after Ctrl-C or SIGTERM.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    parser = build_parser()
    completion.answer_shell(parser)
    if not given:
        parser.print_help()
        return 0
    if not given[0].startswith("-") and given[0] not in VERBS:
        return _explain(_unknown_verb(given[0]))
    _log_to_the_terminal()
    logging.getLogger(PROGRESS).setLevel(logging.INFO)
    try:
        parsed = parser.parse_args(plugins.with_verb(given))
        status: int = parsed.run(parsed)
        sys.stdout.flush()
    except ExplainedError as error:
        return _explain(error)
    except BrokenPipeError:
        return _reader_left()
    except OSError as error:
        where = str(error.filename or "")
        what = f"a file operation failed: {error.strerror or error}"
        return _explain(ExplainedError(what, where=where, fix="check the path and the free space"))
    except KeyboardInterrupt as stop:
        notes = getattr(stop, "__notes__", ())
        error_console().print(" ".join(["stereogs: interrupted", *notes]))
        return INTERRUPTED
    return status


def _reader_left() -> int:
    """Whoever read the output has seen enough, as `head` does; Python must not flush to it on exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _log_to_the_terminal() -> None:
    from .messages.terminal import PlainFormatter

    handler = logging.StreamHandler()
    handler.setFormatter(PlainFormatter("stereogs: %(message)s"))
    logging.basicConfig(level=logging.WARNING, handlers=[handler])


def build_parser() -> argparse.ArgumentParser:
    """The whole command line, verb by verb."""
    parser = CommandParser(
        prog="stereogs",
        description="Three to twenty-four photographs become a 3D Gaussian scene.",
        epilog=_EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument("--version", action=_Version, help="print the version and exit")
    verbs = parser.add_subparsers(title="verbs", metavar="VERB", required=True)
    for verb in VERBS.values():
        verb.add(verbs)
    return parser


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None) -> None:
        super().__init__(option_strings, dest, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"{parser.prog} {version('stereogs-plugins')}")
        parser.exit()


def _unknown_verb(name: str) -> ExplainedError:
    return ExplainedError(
        f"there is no verb {name!r}{did_you_mean(name, VERBS)}",
        where="the command line",
        fix=f"verbs: {listing(VERBS)}; `stereogs --help` says what they do",
    )


def _explain(error: ExplainedError) -> int:
    if os.environ.get(TRACE) == "1":
        import traceback

        traceback.print_exception(error)
    console = error_console()
    console.print(f"stereogs: {error.what}")
    for label, text in (("where", error.where), ("fix", error.fix)):
        if text:
            indented = text.replace("\n", "\n" + " " * 9)
            console.print(f"  {label:<6} {indented}")
    return USAGE_ERROR


if __name__ == "__main__":
    sys.exit(main())
