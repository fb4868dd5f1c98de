"""YAML as a tree of values with their lines.

Plain scalars follow YAML 1.2's core rules, not PyYAML's older ones: `yes`, `no`, `on` and `off` are
text, `1e-3` is a number, `012` is twelve and `1:30` is text. A repeated key, an alias and a tag such
as `!!python/object` are refused. `to_yaml` writes text that `parse` reads back unchanged.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml
from yaml.reader import ReaderError

from ..errors import PipelineError
from ..toolkit.cache.remote import local_copy

Scalar = str | int | float | bool | None

_WORDS: Mapping[str, Scalar] = {"": None, "~": None} | {
    form: value
    for word, value in {"null": None, "true": True, "false": False}.items()
    for form in (word, word.capitalize(), word.upper())
}
_INTEGER = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_SPECIAL = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_CORE_TAGS = {f"tag:yaml.org,2002:{kind}" for kind in ("str", "seq", "map")}
_LEFT_OPEN = ("while parsing a flow", "while scanning a simple key", "while scanning a quoted")
"""How PyYAML's errors about a bracket, key or quotation mark without its end begin."""
_MAX_DEPTH = 32
_MAX_BYTES = 100_000


@dataclass(frozen=True)
class Place:
    """Where a value was written.

    Args:
        source: a file, or an option such as "--set training.seed=1".
        line: 1-based; None for an option.
    """

    source: str
    line: int | None = None

    def __str__(self) -> str:
        return self.source if self.line is None else f"{self.source}:{self.line}"

    def error(self, what: str, fix: str = "") -> PipelineError:
        """Return an error at this place."""
        return PipelineError(what, where=str(self), fix=fix)


@dataclass
class Node:
    """A value and its place. `content` is a scalar, a list of nodes, or nodes by key."""

    content: Scalar | list[Node] | dict[str, Node]
    place: Place

    @property
    def kind(self) -> str:
        """For messages: "a mapping", "a list", or the scalar itself."""
        if isinstance(self.content, dict):
            return "a mapping"
        if isinstance(self.content, list):
            return "a list"
        return "empty" if self.content is None else repr(self.content)

    def as_written(self) -> Any:
        """Return plain values, with environment variables as written."""
        if isinstance(self.content, dict):
            return {key: child.as_written() for key, child in self.content.items()}
        if isinstance(self.content, list):
            return [child.as_written() for child in self.content]
        return self.content

    def at(self, path: tuple[str | int, ...]) -> Node:
        """Return the node at a path of keys and indices, or the last existing node on the way."""
        node = self
        for step in path:
            if isinstance(node.content, dict) and step in node.content:
                node = node.content[str(step)]
            elif isinstance(node.content, list) and isinstance(step, int):
                node = node.content[step] if step < len(node.content) else node
            else:
                break
        return node


def read(path: Path) -> Node:
    """Read a YAML file, also one at an address.

    Raises:
        PipelineError: it is missing, not text, or not the YAML described above; with its line.
        RunError: the address cannot be read.
    """
    path = local_copy(path)
    try:
        if path.exists() and not path.is_file():
            raise OSError("it is not a regular file")
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise Place(str(path)).error(
            f"the pipeline file cannot be read: {error.strerror or error}",
            fix="give the path of a pipeline file, or the name of a ready one, for example 3dgs",
        ) from error
    if len(data) > _MAX_BYTES:
        raise Place(str(path)).error(
            f"the file has more than {_MAX_BYTES:,} bytes, too many for a pipeline",
            fix="give the path of a pipeline file, for example pipelines/3dgs.yaml",
        )
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        place = Place(str(path), data[: error.start].count(b"\n") + 1)
        raise place.error("the file is not UTF-8 text", fix="save it as UTF-8") from error
    return parse(text, str(path))


def parse(text: str, source: str, *, has_lines: bool = True) -> Node:
    """Parse YAML text.

    Args:
        source: named in errors.
        has_lines: False for a value from the command line, whose place has no line.

    Raises:
        PipelineError: see `read`.
    """

    place = _places(source, has_lines)
    root = _compose(text, source, has_lines)
    return Node(None, place(0)) if root is None else _converted(root, place, set())


def _places(source: str, has_lines: bool) -> Callable[[int], Place]:
    """Return the function from 0-based lines to places."""
    return lambda line: Place(source, line + 1 if has_lines else None)


class _Loader(yaml.BaseLoader):
    """PyYAML's loader of plain nodes, with a limit on their depth."""

    _depth = 0

    def __init__(self, text: str, place: Callable[[int], Place]) -> None:
        super().__init__(text)
        self._place = place

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self._depth > _MAX_DEPTH:
            raise self._place(self.peek_event().start_mark.line).error(
                "the YAML is nested too deeply",
                fix="a pipeline has sections, components and their settings; check the brackets",
            )
        self._depth += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1


@lru_cache(maxsize=128)  # campaigns read the same files for each of hundreds of runs
def _compose(text: str, source: str, has_lines: bool) -> yaml.Node | None:
    """Return PyYAML's tree, which no caller changes; its errors become PipelineErrors."""
    place = _places(source, has_lines)
    loader: _Loader | None = None
    try:
        loader = _Loader(text, place)
        return loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        lines = text.splitlines()
        line = _error_line(error, len(lines))
        problem = " ".join(filter(None, (error.context, error.problem)))
        fix = "check the indentation, colons, quotes and brackets at this line"
        if "${" in lines[line]:
            fix = "within { } put quotes around a value that contains ${...}"
        raise place(line).error(f"this is not valid YAML: {problem}", fix) from error
    except ReaderError as error:
        raise place(len(text[: error.position + 1].splitlines()) - 1).error(
            f"the character U+{error.character:04X} is not allowed in YAML",
            fix="remove it; it may be invisible in an editor",
        ) from error
    except (ValueError, OverflowError) as error:  # PyYAML does not check the number of an escape
        raise place(loader.line if loader else 0).error(
            'this is not valid YAML: an escape such as "\\U00110000" is not a character',
            fix="write the character itself",
        ) from error


def _error_line(error: yaml.MarkedYAMLError, count: int) -> int:
    """The 0-based line of an error; for a bracket left open, the line of the bracket."""
    marks = [error.problem_mark, error.context_mark]
    if str(error.context).startswith(_LEFT_OPEN):
        marks.reverse()
    lines = [mark.line for mark in marks if mark is not None]
    return next((line for line in lines if line < count), count - 1)


def _converted(node: yaml.Node, place: Callable[[int], Place], seen: set[int]) -> Node:
    """Convert PyYAML's node; `seen` has the ids of earlier nodes, as an alias returns its node again."""
    here = place(node.start_mark.line)
    if id(node) in seen:
        raise here.error(
            "anchors and aliases (& and *) are not supported in pipelines",
            fix="write the value out where it is used",
        )
    seen.add(id(node))
    if node.tag not in _CORE_TAGS:
        raise here.error(
            f"the tag {node.tag} is not supported in pipelines",
            fix="remove the tag; the setting determines the type of its value",
        )
    if isinstance(node, yaml.SequenceNode):
        return Node([_converted(item, place, seen) for item in node.value], here)
    if isinstance(node, yaml.ScalarNode):
        text = _checked_text(node.value, here)
        return Node(text if node.style else resolve(text), here)
    result: dict[str, Node] = {}
    for key, value in node.value:
        key_place = place(key.start_mark.line)
        if not isinstance(key, yaml.ScalarNode):
            raise key_place.error(
                "a key must be a plain word",
                fix="write `name: value`, without ? and brackets in front of the colon",
            )
        name = _checked_text(key.value, key_place)
        if name in result:
            raise key_place.error(
                f"the key {name!r} is written twice",
                fix=f"remove one of them; the first is at {result[name].place}",
            )
        result[name] = Node(_converted(value, place, seen).content, key_place)
    return Node(result, here)


def _checked_text(text: str, place: Place) -> str:
    """Return the text; refuse unpaired surrogates, which cannot be written to a file."""
    surrogate = next((c for c in text if "\ud800" <= c <= "\udfff"), None)
    if surrogate is not None:
        raise place.error(
            f"unpaired surrogate \\u{ord(surrogate):04X}",
            fix="write the character itself, or \\U and its eight digits",
        )
    return text


def resolve(text: str) -> Scalar:
    """Return the value of an unquoted scalar under YAML 1.2's core rules."""
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text) and len(text) <= 20:
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    if _SPECIAL.fullmatch(text):
        return float(text.replace(".", ""))
    return text


class _Dumper(yaml.SafeDumper):
    """Quotes text that `resolve` would read as another value, and writes no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_text(self, text: str) -> yaml.ScalarNode:
        style = None if resolve(text) == text else "'"
        if not text.isprintable():
            style = '"'  # the only style with escapes: others fold line breaks and lose U+0085
        return self.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _Dumper.represent_text)


def to_yaml(value: Any) -> str:
    """Return plain dicts, lists and scalars as YAML, keys in their order."""
    return str(yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100))
