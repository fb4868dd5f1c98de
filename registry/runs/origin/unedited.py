"""Whether a run folder's pipeline is still the one that the run was made with."""

from __future__ import annotations

from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

from ...contract.hook_points import HOOK_POINTS
from ...errors import RunError
from ...pipeline.pipeline import Pipeline, build_pipeline
from ...pipeline.yaml_source import parse
from ...plugins.discovery import Plugins

_NO_PART = [point.section for point in HOOK_POINTS if point.observes]
"""Sections that may change from one part of a run to the next: no bit depends on them."""


def check_unedited(file: Path, now: Pipeline, before: str, plugins: Plugins) -> None:
    """Refuse a pipeline that means something else than before. Comments, layout and observers may change.

    Args:
        file: the pipeline's file.
        now: what it holds.
        before: the text that the run was made with.

    Raises:
        RunError: it was edited; names the first line that differs.
    """
    text = file.read_text("utf-8")
    if text == before or _meaning(now) == _meaning(_without_observers(before, plugins)):
        return
    number, written, was = _first_change(before.splitlines(), text.splitlines())
    raise RunError(
        f"the pipeline is not the one that the run was made with: {_quoted(written)} "
        f"in place of {_quoted(was)}",
        where=f"{file}:{number}",
        fix="bring that line back, or train the changed pipeline into a folder of its own",
    )


def _meaning(pipeline: Pipeline) -> dict[str, Any]:
    return {key: value for key, value in pipeline.plain().items() if key not in _NO_PART}


def _without_observers(text: str, plugins: Plugins) -> Pipeline:
    """A pipeline as it was; the packages of its observers may be gone."""
    root = parse(text, "pipeline")
    if isinstance(root.content, dict):
        for section in _NO_PART:
            root.content.pop(section, None)
    return build_pipeline(root, plugins)


def _first_change(before: list[str], now: list[str]) -> tuple[int, list[str], list[str]]:
    """The 1-based line where a change begins that is more than a comment, its lines, and those before."""
    changes = SequenceMatcher(None, before, now, autojunk=False).get_opcodes()
    for kind, first, last, begin, end in changes:
        written, was = _content(now[begin:end]), _content(before[first:last])
        if kind != "equal" and written != was:
            return begin + 1, written, was
    return 1, [], []  # the same lines, which mean something else to the plugins of today


def _content(lines: list[str]) -> list[str]:
    return [line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")]


def _quoted(lines: list[str]) -> str:
    return f"`{lines[0]}`" if lines else "nothing"
