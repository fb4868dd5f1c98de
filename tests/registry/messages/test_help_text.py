from __future__ import annotations

import argparse

import pytest

from registry.messages.terminal import HelpFormatter
from tests.host import main, verbs

TEXT = """\
examples:
  one two                 what it is for, which is told at such length that no line has room for it
  stereogs train pipeline.yaml --set this=that --set one=other --set more=still --set yet=more

Prose that goes on and on, beyond
what a line holds, is filled anew as one paragraph, whatever its lines were.
"""


@pytest.mark.parametrize("verb", ["", *verbs()])
def test_the_help_of_every_verb_fits_80_columns(
    verb: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as caught:
        main([verb, "--help"] if verb else ["--help"])
    assert caught.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) > 5
    assert [line for line in lines if len(line) > 80] == []


def test_examples_are_wrapped_by_line_and_prose_by_paragraph(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "62")
    parser = argparse.ArgumentParser(prog="p", epilog=TEXT, formatter_class=HelpFormatter)
    lines = parser.format_help().partition("examples:")[2].splitlines()
    assert lines[1] == "  one two                 what it is for, which is told at"
    assert lines[2].startswith(" " * 26 + "such length")
    (start,) = (n for n, line in enumerate(lines) if line.startswith("  stereogs train"))
    assert lines[start + 1].startswith("    one=other")
    (start,) = (n for n, line in enumerate(lines) if line.startswith("Prose"))
    assert lines[start].endswith("beyond what a line holds, is")
