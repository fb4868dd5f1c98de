"""`check_command` passes a good command and catches each kind of bad one."""

from __future__ import annotations

import argparse

import pytest

from stereogs.api import Command
from stereogs.testing import check_command
from tests.host import Completion


class Good(Command):
    epilog = "examples:\n  stereogs good\n"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--fast", action="store_true", help="less than 5 %% of the time")

    def run(self, arguments: argparse.Namespace) -> int:
        return 0


class WithoutRun(Command):
    pass


class Twice(Good):
    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        super().add_arguments(parser)
        super().add_arguments(parser)


class Help(Good):
    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--help", action="store_true")


class Percent(Good):
    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--fast", help="5 % of the time")


class Reserved(Good):
    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("command")


def test_good_commands_pass() -> None:
    check_command(Completion)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (int, "does not derive from stereogs.api.Command"),
        (WithoutRun, "does not define run"),
        (Twice, "the arguments clash"),
        (Help, "the arguments clash"),
        (Percent, "help cannot be printed"),
        (Reserved, "a name that the host uses"),
        (Good, "imports torch; import it within"),
    ],
)
def test_bad_commands_fail(command: type[Command], message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_command(command)


def test_a_module_without_docstring_has_no_summary(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{Good.__module__}.__doc__", None)
    with pytest.raises(AssertionError, match="has no docstring"):
        check_command(Good)
