"""The help of the command line, in lines that a terminal can show."""

from __future__ import annotations

import argparse
import re
from itertools import groupby
from textwrap import wrap


class HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Wraps what stands before and behind the options: prose by paragraphs, examples line by line.

    A line that is indented is an example; what does not fit goes on below its explanation, which two
    or more spaces set apart.
    """

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        lines: list[str] = []
        for is_prose, block in groupby(text.splitlines(), _is_prose):
            if is_prose:
                lines += wrapped(" ".join(block), width)
            else:
                lines += (part for line in block for part in wrapped(line, width) or [""])
        return "\n".join(indent + line for line in lines)


def _is_prose(line: str) -> bool:
    return bool(line.strip()) and not line.startswith(" ")


def wrapped(line: str, width: int) -> list[str]:
    """The line in pieces of at most so many characters, words and paths whole; none if it is empty.

    What goes on stands below the explanation that two or more spaces set apart, else two spaces further in.
    """
    indented = re.match(r"( +)(?:\S+(?: \S+)*  +(?=\S))?", line)
    further = min(indented.end(), width // 2) if indented else 0
    if indented and indented.end() == len(indented[1]):
        further += 2
    return wrap(
        line,
        width,
        subsequent_indent=" " * further,
        break_long_words=False,
        break_on_hyphens=False,
    )
