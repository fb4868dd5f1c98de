"""What the command line prints: log lines, the table of results."""

from __future__ import annotations

import io
import logging

import pytest
from rich.console import Console

from stereogs.command_line.output import LogLines, results_table


def test_log_lines_are_escaped(capsys: pytest.CaptureFixture[str]) -> None:
    evil = "a\x1b[2J\x1b]0;owned\x07\x9b31mb\u202ec\r\nd"
    LogLines().emit(logging.LogRecord("stereogs", logging.INFO, "", 0, "%s", (evil,), None))
    written = capsys.readouterr().err
    assert written.startswith("stereogs: a\\x1b[2J")
    assert written.replace("\n", "").isprintable()


def test_a_log_line_is_printed_once(capsys: pytest.CaptureFixture[str]) -> None:
    """A scene that is read again, smaller, repeats its warnings."""
    lines = LogLines()
    for text in ("one", "two", "one"):
        lines.emit(logging.LogRecord("stereogs", logging.INFO, "", 0, "%s", (text,), None))
    assert capsys.readouterr().err == "stereogs: one\nstereogs: two\n"


def test_the_table_distinguishes_missing_and_infinite_scores() -> None:
    row = {"psnr": None, "lpips": None}
    results = {
        "pipeline": "p",
        "scene": {"name": "s"},
        "test": row,
        "train": {"psnr": 20.0, "lpips": None, "avge": 0.5},
        "views": {"test": {"v": row}, "train": {}},
        "unavailable": {"lpips": "no network is named"},
        "infinite": {"test": {"psnr": ["v"]}},
    }
    stream = io.StringIO()
    Console(file=stream, width=100).print(results_table(results))
    lines = stream.getvalue().splitlines()
    cells = {line.split("│")[1].strip(): line.split("│")[2:-1] for line in lines if "│" in line}
    assert [cell.strip() for cell in cells["v"]] == ["inf", "–", "–"]  # noqa: RUF001
    assert [cell.strip() for cell in cells["train mean"]] == ["20.00", "–", "0.5000"]  # noqa: RUF001
    assert "lpips: no network is named" in stream.getvalue()
