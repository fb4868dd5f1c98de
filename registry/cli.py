"""The `stereogs` command.

Help, the version and mistakes are answered without importing torch: only the verb that is given is imported,
and it imports the rest in its `run`.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Mapping, Sequence

from core_rasterizer.errors import ExplainedError

from .commands.output import add_verb, error_console
from .commands.plugins import with_verb
from .errors import PluginError
from .messages.command_parser import CommandParser
from .messages.help_text import HelpFormatter
from .messages.suggestions import did_you_mean, listing
from .plugins.commands import Verb, verbs

USAGE_ERROR = 2
INTERRUPTED = 130
TRACE = "STEREOGS_TRACE"
"""Environment variable: 1 shows the Python traceback of every error."""

COMPLETING = "_ARGCOMPLETE"
"""Environment variable that a shell sets to ask how a command line continues."""

PROGRESS = "stereogs"
"""Logger whose INFO lines are shown: a component that takes long tells of it there."""

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
    """Run the command line; returns the exit status.

    0 done; 1 a check found a fault; 2 something is wrong and was explained; 130 after Ctrl-C or SIGTERM.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    _log_to_the_terminal()
    logging.getLogger(PROGRESS).setLevel(logging.INFO)
    try:
        if COMPLETING in os.environ:
            from .commands.completing import answer_shell

            answer_shell(build_parser(None))
        if not given:
            build_parser(given).print_help()
            return 0
        parsed = parse(given)
        status = _run(parsed, given[0])
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


def _run(parsed: argparse.Namespace, verb: str) -> int:
    """Run the verb; an error that explains nothing is blamed on the plugin that offers the verb."""
    try:
        status: int = parsed.command.run(parsed)
    except (ExplainedError, OSError):
        raise
    except Exception as error:
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
    return build_parser(given).parse_args(with_verb(list(given)))


def build_parser(given: Sequence[str] | None) -> argparse.ArgumentParser:
    """The parser of a command line: of the verb that is given, or with a line for each verb.

    Args:
        given: the command line; None adds the arguments of every verb.

    Raises:
        ExplainedError: no verb has the given name, or two plugins offer the same one.
    """
    parser = CommandParser(
        prog="stereogs",
        description="Three to twenty-four photographs become a 3D Gaussian scene.",
        epilog=_EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument("--version", action=_Version, help="print the version and exit")
    actions, known = parser.add_subparsers(title="verbs", metavar="VERB", required=True), verbs()
    if given and not given[0].startswith("-") and given[0] not in known:
        raise _unknown_verb(given[0], known)
    chosen = list(known) if given is None else [name for name in given[:1] if name in known]
    for name in chosen or known:
        verb = known[name]
        if chosen:
            command = verb.load()
            own = add_verb(actions, name, verb.summary, command.epilog)
            command.add_arguments(own)
            own.set_defaults(command=command)
        else:
            add_verb(actions, name, verb.summary, "")
    return parser


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None) -> None:
        super().__init__(option_strings, dest, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"{parser.prog} {version('stereogs-plugins')}")
        parser.exit()


def _unknown_verb(name: str, known: Mapping[str, Verb]) -> ExplainedError:
    return ExplainedError(
        f"unknown verb {name!r}{did_you_mean(name, known)}",
        where="the command line",
        fix=f"verbs: {listing(known)}; `stereogs --help` describes them",
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
