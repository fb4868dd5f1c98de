"""Variations: one setting with several values, or several named alternatives."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass

from registry.errors import PipelineError
from registry.pipeline import Node, item_names, resolve


@dataclass(frozen=True)
class Change:
    """A value for a setting.

    Args:
        path: dotted, as for `--set`.
        value: with the place where it was written.
    """

    path: str
    value: Node

    def within(self, target: str) -> bool:
        """Whether it changes `target` or something inside."""
        return self.path == target or self.path.startswith(f"{target}.")


@dataclass(frozen=True)
class Choice:
    """One value of a variation.

    Args:
        label: what tables call it.
        changes: what it changes in the pipeline.
    """

    label: str
    changes: tuple[Change, ...]

    @property
    def number(self) -> float | None:
        """The label as a number, if it is one; for plots."""
        value = resolve(self.label)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        return float(value) if math.isfinite(value) else None


@dataclass(frozen=True)
class Variation:
    """What is varied, and its values in the order of the table."""

    name: str
    choices: tuple[Choice, ...]


def values(path: str, node: Node) -> Variation:
    """The variation of one setting over a list of values.

    Raises:
        PipelineError: not a list, an empty one, or a value twice.
    """
    if not isinstance(node.content, list):
        raise PipelineError(
            f"the values of {path} must be a list or named alternatives, not {node.kind}",
            where=str(node.place),
            fix=f"write `{path}: [value, value]`",
        )
    choices: dict[str, Choice] = {}
    for value in node.content:
        label = _label(value)
        if label in choices:
            raise PipelineError(
                f"{path} has the value {label} twice", where=str(value.place), fix="remove one"
            )
        choices[label] = Choice(label, (Change(path, value),))
    if not choices:
        raise PipelineError(
            f"{path} has no values", where=str(node.place), fix="give two or more, or leave it out"
        )
    return Variation(path, tuple(choices.values()))


def alternatives(name: str, node: Node) -> Variation:
    """The variation of named alternatives: a mapping from label to changes, each path to value.

    Raises:
        PipelineError: an alternative that is not a mapping, or none that changes anything.
    """
    assert isinstance(node.content, dict)
    choices: dict[str, Choice] = {}
    for label, changes in node.content.items():
        if not isinstance(changes.content, dict):
            raise PipelineError(
                f"the alternative {label!r} of {name} must map settings to values, "
                f"not {changes.kind}",
                where=str(changes.place),
                fix="for example {priors.stereo.path: model.onnx}; {} changes nothing",
            )
        made = tuple(Change(path, value) for path, value in changes.content.items())
        choices[label] = Choice(label, made)
    if not any(choice.changes for choice in choices.values()):
        raise PipelineError(
            f"no alternative of {name} changes anything",
            where=str(node.place),
            fix="give each the settings that it changes",
        )
    return Variation(name, tuple(choices.values()))


def _label(value: Node) -> str:
    """A scalar as it is; a component by its name; anything else as JSON."""
    if isinstance(value.content, str):
        return value.content
    names = item_names(value)
    return names[0] if names else json.dumps(value.as_written(), ensure_ascii=False)
