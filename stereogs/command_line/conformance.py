"""Check one command class."""

from __future__ import annotations

import argparse
import inspect
import os
import subprocess
import sys
from importlib.metadata import entry_points

from registry.messages.terminal import CommandParser, HelpFormatter
from registry.testing.assertions import require

from .command import Command
from .installed import COMMANDS, Verb

_RESERVED = ("command", "verb")
_IMPORTS_TORCH = (
    "import sys, importlib; importlib.import_module(sys.argv[1]); sys.exit('torch' in sys.modules)"
)


def check_command(command: type[Command]) -> None:
    """Check a command class: its arguments, help, module and entry point.

    Raises:
        AssertionError: the class does not derive from `stereogs.api.Command` or lacks `run`; its arguments
            clash with each other or with the host's; its help cannot be printed; its module has no
            docstring for `stereogs --help`, or importing it imports torch.
        PluginError: an entry point of its module does not match the registered name.
    """
    require(
        issubclass(command, Command),
        f"{command.__name__} does not derive from stereogs.api.Command",
    )
    require(not inspect.isabstract(command), f"{command.__name__} does not define run(arguments)")
    built = command()
    parser = CommandParser(prog="stereogs", epilog=built.epilog, formatter_class=HelpFormatter)
    try:
        built.add_arguments(parser)
    except argparse.ArgumentError as error:
        raise AssertionError(f"the arguments clash: {error}") from error
    for action in parser._actions:
        require(
            action.dest not in _RESERVED,
            f"the argument {action.dest!r} has a name that the host uses; set another `dest`",
        )
    try:
        parser.format_help()
    except (ValueError, TypeError, KeyError) as error:
        raise AssertionError(f"the help cannot be printed: {error}; write % as %%") from error
    name = command.__module__
    summary = (sys.modules[name].__doc__ or "").strip()
    require(
        bool(summary),
        f"the module {name} has no docstring: its first line is the command's summary",
    )
    done = subprocess.run(
        [sys.executable, "-c", _IMPORTS_TORCH, name],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    require(not done.stderr, f"the module {name} cannot be imported: {done.stderr[-500:]}")
    require(not done.returncode, f"importing {name} imports torch; import it within `run`")
    for entry in entry_points(group=COMMANDS):
        if entry.module == name:
            Verb(entry).load()
