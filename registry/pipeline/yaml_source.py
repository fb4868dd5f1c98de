"""YAML as a tree that knows where each value stands, read without YAML's traps.

Plain scalars follow YAML 1.2's core rules, not PyYAML's older ones: `yes`, `no`, `on` and `off` are
text, `1e-3` is a number, `012` is twelve and `1:30` is text. A repeated key, an alias and a tag such
as `!!python/object` are refused. `to_yaml` writes text that `parse` reads back unchanged.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from yaml.reader import ReaderError

from ..errors import PipelineError

Scalar = str | int | float | bool | None

_WORDS: dict[str, Scalar] = {"": None, "~": None, "null": None, "true": True, "false": False}
_WORDS |= {word.capitalize(): _WORDS[word] for word in ("null", "true", "false")}
_WORDS |= {word.upper(): _WORDS[word] for word in ("null", "true", "false")}
_INTEGER = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_SPECIAL = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_CORE_TAGS = {f"tag:yaml.org,2002:{kind}" for kind in ("str", "seq", "map")}
_LEFT_OPEN = ("while parsing a flow", "while scanning a simple key", "while scanning a quoted")
"""How PyYAML begins to tell of a bracket, key or quotation mark without its end."""
_MAX_DEPTH = 32
_MAX_BYTES = 100_000


@dataclass(frozen=True)
class Place:
    """Where a value was written: a line of a file, or the command line.

    Args:
        source: the file as the user named it, or the option, for example "--set training.seed=1".
        line: 1-based, or None for the command line.
    """

    source: str
    line: int | None = None

    def __str__(self) -> str:
        return self.source if self.line is None else f"{self.source}:{self.line}"


@dataclass
class Node:
    """A value with its place. `content` is a scalar, a list of nodes, or nodes by key."""

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
        """Plain values, environment variables not filled in."""
        if isinstance(self.content, dict):
            return {key: child.as_written() for key, child in self.content.items()}
        if isinstance(self.content, list):
            return [child.as_written() for child in self.content]
        return self.content

    def at(self, path: tuple[str | int, ...]) -> Node:
        """The node at a path of keys and indices, or the last one on the way that exists."""
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
    """Read a YAML file.

    Raises:
        PipelineError: it is missing, not text, or not the YAML described above; with its line.
    """
    try:
        if path.exists() and not path.is_file():
            raise OSError("it is no regular file")
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise PipelineError(
            f"the pipeline file cannot be read: {error.strerror or error}",
            where=str(path),
            fix="give the path of a pipeline file, or the name of a ready one, for example 3dgs",
        ) from error
    if len(data) > _MAX_BYTES:
        raise PipelineError(
            f"the file has more than {_MAX_BYTES:,} bytes, too many for a pipeline",
            where=str(path),
            fix="give the path of a pipeline file, for example pipelines/3dgs.yaml",
        )
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise PipelineError(
            "the file is not UTF-8 text", where=f"{path}:{line}", fix="save it as UTF-8"
        ) from error
    return parse(text, str(path))


def parse(text: str, source: str, *, has_lines: bool = True) -> Node:
    """Parse YAML text.

    Args:
        source: named in errors.
        has_lines: False for a value from the command line, whose place has no line.

    Raises:
        PipelineError: see `read`.
    """
    root = _compose(text, source, has_lines)
    if root is None:
        return Node(None, Place(source, 1 if has_lines else None))
    return _Converter(source, has_lines).convert(root)


class _TooDeepError(Exception):
    """Nodes within nodes beyond what any pipeline has; its argument is the 0-based line."""


class _Loader(yaml.BaseLoader):
    """PyYAML's loader of plain nodes, which stops where they are nested too deeply."""

    _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self._depth > _MAX_DEPTH:
            raise _TooDeepError(self.peek_event().start_mark.line)
        self._depth += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1


def _compose(text: str, source: str, has_lines: bool) -> yaml.Node | None:
    """PyYAML's tree, its errors explained with their line."""

    def refused(what: str, line: int, fix: str = "") -> PipelineError:
        where = Place(source, line + 1 if has_lines else None)
        return PipelineError(what, where=str(where), fix=fix)

    loader: _Loader | None = None
    try:
        loader = _Loader(text)
        return loader.get_single_node()
    except _TooDeepError as error:
        fix = "a pipeline has sections, components and their settings; check the brackets"
        raise refused("the YAML is nested too deeply", error.args[0], fix) from error
    except yaml.MarkedYAMLError as error:
        lines = text.splitlines()
        line = _error_line(error, len(lines))
        problem = " ".join(filter(None, (error.context, error.problem)))
        fix = "check the indentation, colons, quotes and brackets at this line"
        if "${" in lines[line]:
            fix = "within { } put quotes around a value that contains ${...}"
        raise refused(f"this is not valid YAML: {problem}", line, fix) from error
    except ReaderError as error:
        what = f"the character U+{error.character:04X} is not allowed in YAML"
        line = len(text[: error.position + 1].splitlines()) - 1
        raise refused(what, line, "remove it; it may be invisible in an editor") from error
    except (ValueError, OverflowError) as error:  # PyYAML looks no escape up before it uses it
        what = 'this is not valid YAML: an escape such as "\\U00110000" stands for no character'
        fix = "write the character itself"
        raise refused(what, loader.line if loader else 0, fix) from error


def _error_line(error: yaml.MarkedYAMLError, count: int) -> int:
    """The 0-based line of an error; of what was left open, where that is noticed further down."""
    marks = [error.problem_mark, error.context_mark]
    if str(error.context).startswith(_LEFT_OPEN):
        marks.reverse()
    lines = [mark.line for mark in marks if mark is not None]
    return next((line for line in lines if line < count), count - 1)


class _Converter:
    """PyYAML's nodes to ours."""

    def __init__(self, source: str, has_lines: bool) -> None:
        self._source, self._has_lines = source, has_lines
        self._seen: set[int] = set()

    def convert(self, node: yaml.Node) -> Node:
        place = self._place(node)
        if id(node) in self._seen:
            raise PipelineError(
                "anchors and aliases (& and *) are not supported in pipelines",
                where=str(place),
                fix="write the value out where it is used",
            )
        self._seen.add(id(node))
        if node.tag not in _CORE_TAGS:
            raise PipelineError(
                f"the tag {node.tag} is not supported in pipelines",
                where=str(place),
                fix="remove the tag; values get their type from what reads them",
            )
        if isinstance(node, yaml.MappingNode):
            return Node(self._mapping(node), place)
        if isinstance(node, yaml.SequenceNode):
            return Node([self.convert(item) for item in node.value], place)
        text = _whole_characters(node.value, place)
        quoted = isinstance(node, yaml.ScalarNode) and node.style
        return Node(text if quoted else resolve(text), place)

    def _mapping(self, node: yaml.MappingNode) -> dict[str, Node]:
        result: dict[str, Node] = {}
        for key, value in node.value:
            place = self._place(key)
            if not isinstance(key, yaml.ScalarNode):
                raise PipelineError(
                    "a key must be a plain word",
                    where=str(place),
                    fix="write `name: value`, without ? and brackets in front of the colon",
                )
            name = _whole_characters(key.value, place)
            if name in result:
                raise PipelineError(
                    f"the key {name!r} is written twice",
                    where=str(place),
                    fix=f"remove one of them; the first is at {result[name].place}",
                )
            child = self.convert(value)
            result[name] = Node(child.content, place)
        return result

    def _place(self, node: yaml.Node) -> Place:
        return Place(self._source, node.start_mark.line + 1 if self._has_lines else None)


def _whole_characters(text: str, place: Place) -> str:
    """Return the text, checked for unpaired surrogates, which cannot be written to a file."""
    surrogate = next((c for c in text if "\ud800" <= c <= "\udfff"), None)
    if surrogate is not None:
        raise PipelineError(
            f"unpaired surrogate \\u{ord(surrogate):04X}",
            where=str(place),
            fix="write the character itself, or \\U and its eight digits",
        )
    return text


def resolve(text: str) -> Scalar:
    """What an unquoted scalar means under YAML 1.2's core rules."""
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
    """Quotes every text that `resolve` would read as something else, and writes no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = None if resolve(text) == text else "'"
    if not text.isprintable():
        style = '"'  # the only style with escapes: others fold line breaks and lose U+0085
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _represent_text)


def to_yaml(value: Any) -> str:
    """Plain dicts, lists and scalars as YAML, keys in their order."""
    return str(yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100))
