"""`stereogs completion`: what a shell needs to complete the command line with the tab key."""

from __future__ import annotations

import argparse
import os
from typing import Any

from .output import Verbs, add_verb

SHELLS = ("bash", "zsh", "fish")
_ASKED = "_ARGCOMPLETE"
"""Environment variable that the shell sets when it wants to know how a line goes on."""
_PIPELINES = ("pipeline", "file", "data")
"""Arguments that take the name of a ready pipeline."""

_EPILOG = """\
examples:
  stereogs completion bash >> ~/.bashrc
  stereogs completion zsh >> ~/.zshrc
  stereogs completion fish > ~/.config/fish/completions/stereogs.fish

Verbs, options, files, names of ready pipelines and of components are completed.
"""


def add(verbs: Verbs) -> None:
    """Add the verb."""
    parser = add_verb(verbs, "completion", "print what makes a shell complete with tab", _EPILOG)
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help="bash, zsh or fish")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print the shell's code."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(["stereogs"], shell=arguments.shell))
    return 0


def answer_shell(parser: argparse.ArgumentParser) -> None:
    """Tell a shell that asks how the line goes on, and end; else return at once."""
    if _ASKED in os.environ:
        import argcomplete

        # Any callable will do, whatever its annotation says.
        argcomplete.autocomplete(parser, default_completer=_complete)  # type: ignore[arg-type]


def _complete(prefix: str, action: argparse.Action, **_: Any) -> list[str]:
    from argcomplete.completers import FilesCompleter

    if action.dest == "name":
        from ..plugins.discovery import Plugins, offered_name

        return [name for e in Plugins().entries if (name := offered_name(e)).startswith(prefix)]
    found = [str(path) for path in FilesCompleter()(prefix)]
    if action.dest in _PIPELINES:
        from ..pipeline.ready import ready_pipelines

        found += [name for name in ready_pipelines() if name.startswith(prefix)]
    return found
