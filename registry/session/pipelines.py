"""A pipeline from a file, a name, text or plain values."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..contract.in_memory import IN_MEMORY
from ..errors import PipelineError
from ..pipeline.pipeline import Pipeline
from ..pipeline.pipeline import build_pipeline as checked_pipeline
from ..pipeline.ready import find_pipeline
from ..pipeline.yaml_source import Node, parse, read, to_yaml
from ..plugins.discovery import Plugins

PathLike = str | os.PathLike[str]
PipelineSource = Pipeline | Mapping[str, Any] | PathLike
"""A pipeline, or what `build_pipeline` makes one from."""


def build_pipeline(
    source: Mapping[str, Any] | PathLike,
    overrides: Sequence[str] = (),
    disable: Sequence[str] = (),
    *,
    plugins: Plugins | None = None,
) -> Pipeline:
    """A checked pipeline. Without a `scene` it is one for a scene that is given to `train`.

    Args:
        source: plain values as a pipeline file holds them; the path of a pipeline file, or the name of
            a ready one; or, if it is a `str` with a line break or a "{" at its start, YAML text.
        overrides: `a.b=value`, as for `--set`; applied before `disable`.
        disable: names of components to switch off, as for `--disable`.
        plugins: where components are looked for; None: the installed plugins.

    Raises:
        PipelineError: anything wrong with it, with its line.
        PluginError: a component that it names cannot be loaded.
    """
    root = _tree(source)
    if isinstance(root.content, dict) and not any(
        text.partition("=")[0].strip().startswith("scene") for text in overrides
    ):
        written = root.content.get("scene")
        if written is None or written.content is None:
            root.content["scene"] = Node(IN_MEMORY, root.place)
    return checked_pipeline(root, plugins or Plugins(), overrides, disable)


def is_text(source: PathLike) -> bool:
    """Whether it is YAML text, not a path."""
    return isinstance(source, str) and ("\n" in source or source.lstrip().startswith("{"))


def _tree(source: Mapping[str, Any] | PathLike) -> Node:
    if isinstance(source, Mapping):
        try:
            text = to_yaml(json.loads(json.dumps(source, default=_plain)))
        except TypeError as error:
            raise PipelineError(
                f"a pipeline is made of plain values: {error}",
                where="the pipeline's values",
                fix="use dicts, lists, texts, numbers, True, False and None",
            ) from error
        return parse(text, "the pipeline's values", has_lines=False)
    if is_text(source):
        return parse(str(source), "the pipeline's text")
    return read(find_pipeline(Path(source).expanduser()))


def _plain(value: object) -> object:
    """What JSON does not know and a pipeline may hold."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"{value!r} is a {type(value).__name__}")
