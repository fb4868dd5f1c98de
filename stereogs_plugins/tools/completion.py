"""Print what makes a shell complete with tab."""

from __future__ import annotations

import argparse

from registry import Command, Register, hookimpl

SHELLS = ("bash", "zsh", "fish")

_EPILOG = """\
examples:
  stereogs completion bash >> ~/.bashrc
  stereogs completion zsh >> ~/.zshrc
  stereogs completion fish > ~/.config/fish/completions/stereogs.fish

options, files, names of ready pipelines and of components are completed.
"""


class Completion(Command):
    """The verb `completion`."""

    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help="bash, zsh or fish")

    def run(self, arguments: argparse.Namespace) -> int:
        """Print the shell's code."""
        from argcomplete.shell_integration import shellcode

        print(shellcode(["stereogs"], shell=arguments.shell))
        return 0


@hookimpl
def stereogs_register_commands(register: Register[Command]) -> None:
    register("completion", Completion)
