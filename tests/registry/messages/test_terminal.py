"""Control characters in text do not reach the terminal."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.table import Table

from registry.messages.terminal import PlainConsole
from registry.messages.visible_text import visible
from stereogs import RunOptions
from tests.host import main

EVIL = "a\x1b[2J\x1b]0;owned\x07\x9b31mb\u202ec\r\nd"
TAMED = "a\\x1b[2J\\x1b]0;owned\\x07\\x9b31mb\\u202ec"


def test_only_control_characters_are_escaped() -> None:
    assert visible(EVIL) == f"{TAMED}\\r\nd"
    harmless = "fern – 21.91 ± 0.03 \t日本\u00a0\n"  # noqa: RUF001
    assert visible(harmless) == harmless


def test_a_console_escapes_control_characters_in_text() -> None:
    file = io.StringIO()
    console = PlainConsole(file=file, force_terminal=True, width=200, color_system="truecolor")
    table = Table(title=EVIL)
    table.add_column(EVIL, style="bold red")
    table.add_row(EVIL)
    console.print(table)
    console.print(EVIL)
    written = file.getvalue()
    assert "\x1b[1;31m" in written  # its own
    for code in ("\x1b[2J", "\x1b]0;", "\x07", "\x9b", "\u202e"):
        assert code not in written
    assert "owned" in written


def test_every_console_of_the_host_is_a_plain_console() -> None:
    assert isinstance(RunOptions().console(), PlainConsole)


def test_control_characters_in_a_name_are_escaped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "\x1b[2Jscene"
    folder.mkdir()
    assert main(["check", str(folder)]) == 2
    assert main(["compare", str(folder)]) == 2
    said = "".join(capsys.readouterr())
    assert "\x1b" not in said
    assert "\\x1b[2Jscene" in said
