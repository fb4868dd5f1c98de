"""Changes of one place of a source file, in Python and in OpenCL C.

Both are formatted by tools, so that one table of patterns serves both: binary operators have a space on each
side. Strings, comments and docstrings are left alone.
"""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_COUNTERPARTS = (
    *(("<", "<="), (">", ">="), ("==", "!="), ("+", "-"), ("*", "/"), ("+=", "-="), ("*=", "/=")),
    *(("&&", "||"), ("and", "or"), ("is not", "is"), ("&", "|"), ("<<", ">>")),
)
_ALWAYS_THERE = ("pass", "min", "max", "any", "all", "True", "False", "fmin", "fmax")
_NAMES = (
    *(("min", "max"), ("fmin", "fmax"), ("any", "all"), ("True", "False"), ("floor", "ceil")),
    *(("width", "height"), ("fx", "fy"), ("cx", "cy"), ("near", "far"), ("left", "right")),
    *(("x", "y"), ("first", "second"), ("rows", "columns"), ("argmin", "argmax"), ("sum", "mean")),
)
_WORD = r"[\w.]+(?:\[\w+\])?"
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d*)?(?:e-?\d+)?f?(?![\w.])")
_PAIR = re.compile(rf"(?<=[\w]\()({_WORD}), ({_WORD})(?=[,)])")
_STATEMENT = re.compile(  # a call, a change of a variable, or an assignment to a part of one
    r"( +)([\w.]+\(.*\)|[\w.>\[\]-]+ [-+*/|&]= .*|\w+[.\[-][\w.>\[\]-]* = .*|(\w+) = .*\b\3\b.*);?$"
)
_NEARBY = 20
_LEFT_ALONE = re.compile(
    r"\s*(?:import|from|def|class|@|#|raise|assert|for \w+ in range|typedef)\b"
)
_SETTING = "Field("
"""In the schema in pipelines/, whose test notices each change."""
_ANNOTATED = re.compile(r"^\s*\w+: [\w\[\], |.]+(?: = |$)")


@dataclass(frozen=True)
class Mutant:
    """A changed line.

    Args:
        file: path within the repository.
        line: its number, from 1.
        old, new: the line before and after.
    """

    file: str
    line: int
    old: str
    new: str

    @property
    def key(self) -> tuple[str, str, str]:
        """What stays equal when lines above are added or removed."""
        return self.file, self.old.strip(), self.new.strip()

    def text(self, root: Path) -> str:
        """Return the changed content of the file below `root`."""
        lines = (root / self.file).read_text("utf-8").split("\n")
        assert lines[self.line - 1] == self.old
        lines[self.line - 1] = self.new
        return "\n".join(lines)

    def is_valid(self, root: Path) -> bool:
        """Whether it is Python that compiles; only a build tells for OpenCL."""
        try:
            compile(self.text(root) if self.file.endswith(".py") else "", self.file, "exec")
        except SyntaxError:
            return False
        return True


def mutants(root: Path, file: str) -> Iterator[Mutant]:
    """Yield all changes of a file; some are not valid code."""
    text = (root / file).read_text("utf-8")
    python = file.endswith(".py")
    lines = text.split("\n")
    masked = (_without_texts(text) if python else _without_comments(text)).split("\n")
    for index, (line, mask) in enumerate(zip(lines, masked, strict=True)):
        if _LEFT_ALONE.match(mask) or _SETTING in mask:
            continue
        nearby = "\n".join(masked[max(0, index - _NEARBY) : index + _NEARBY])
        for begin, end, replacement in _changes(mask, python):
            new = line[:begin] + replacement + line[end:]
            known = replacement in _ALWAYS_THERE or not replacement.isidentifier()
            if not known and not re.search(rf"\b{replacement}\b", nearby):
                continue  # an undefined name is noticed by any test
            yield Mutant(file, index + 1, line, new)


def _changes(mask: str, python: bool) -> Iterator[tuple[int, int, str]]:
    """Yield (begin, end, replacement) of each change of a line without texts."""
    annotation = _ANNOTATED.match(mask) if python else None
    mask = "\0" * annotation.end() + mask[annotation.end() :] if annotation else mask
    for pairs, space in ((_COUNTERPARTS, " "), (_NAMES, r"\b")):
        for pair in pairs:
            for old, new in (pair, pair[::-1]):
                for found in re.finditer(rf"{space}({re.escape(old)}){space}", mask):
                    joins_paths = old == "/" and ("\0" in mask or "folder" in mask)
                    if not joins_paths and not (old == "is" and "is not" in mask):
                        yield *found.span(1), new
    for found in _NUMBER.finditer(mask):
        number = found[0].rstrip("f")
        whole = number.isdigit() or float(number) == 0
        yield *found.span(), str(int(float(number)) + 1) if whole else f"10 * {found[0]}"
    for found in _PAIR.finditer(mask):
        yield *found.span(), f"{found[2]}, {found[1]}"
    statement = _STATEMENT.match(mask)
    if statement and statement[2].count("(") == statement[2].count(")"):
        yield statement.end(1), len(mask), "pass" if python else ";"


def _without_texts(text: str) -> str:
    """Replace strings and comments of Python by spaces that no pattern matches."""
    rows = [list(line) for line in text.split("\n")]
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in (tokenize.STRING, tokenize.COMMENT):
            (row, begin), (last, end) = token.start, token.end
            for number in range(row, last + 1):
                line = rows[number - 1]
                start = begin if number == row else 0
                stop = end if number == last else len(line)
                line[start:stop] = "\0" * (stop - start)
    return "\n".join("".join(row) for row in rows)


def _without_comments(text: str) -> str:
    """Replace comments of C likewise, and lines of the preprocessor other than macros."""

    def blank(found: re.Match[str]) -> str:
        return re.sub(r"[^\n]", "\0", found[0])

    text = re.sub(r"/\*.*?\*/|//[^\n]*", blank, text, flags=re.DOTALL)
    return re.sub(r"^#(?!define).*$", blank, text, flags=re.MULTILINE)
