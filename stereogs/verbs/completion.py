"""Print the code that enables tab completion in a shell."""

from __future__ import annotations

import argparse

from ..command_line.command import Command

_EPILOG = """\
examples:
  stereogs completion bash >> ~/.bashrc
  stereogs completion zsh >> ~/.zshrc
  stereogs completion fish > ~/.config/fish/completions/stereogs.fish

Completes options, files, and the names of ready pipelines and components.
"""


class Completion(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        shells = ("bash", "zsh", "fish")
        parser.add_argument("shell", choices=shells, metavar="SHELL", help="bash, zsh or fish")

    def run(self, arguments: argparse.Namespace) -> int:
        from argcomplete.shell_integration import shellcode

        print(shellcode(["stereogs"], shell=arguments.shell))
        return 0
