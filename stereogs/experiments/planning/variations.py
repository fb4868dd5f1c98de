"""Changes of a pipeline: values of a setting, named alternatives, scenes."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import PurePath

from registry.errors import PipelineError
from registry.pipeline.edits import item_names
from registry.pipeline.yaml_source import Node, resolve

DATA = "STEREOGS_DATA"


@dataclass(frozen=True)
class Change:
    """A new value of a setting.

    Args:
        path: dotted, as for `--set`.
        value: with its place in a file or on the command line.
    """

    path: str
    value: Node

    def within(self, target: str) -> bool:
        """Return True if it changes `target` or one of its settings."""
        return self.path == target or self.path.startswith(f"{target}.")


@dataclass(frozen=True)
class Alternative:
    """One value of a variation.

    Args:
        label: text in tables.
        changes: changes of the pipeline.
    """

    label: str
    changes: tuple[Change, ...]

    @property
    def number(self) -> float | None:
        """The label as a finite number, for plots; None if it is not a number."""
        value = resolve(self.label)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        return float(value) if math.isfinite(value) else None


@dataclass(frozen=True)
class Variation:
    """A varied setting with its values, in the order of the table."""

    name: str
    choices: tuple[Alternative, ...]


def values(path: str, node: Node) -> Variation:
    """Return the variation of a setting over a list of values.

    Raises:
        PipelineError: not a list, an empty list, or a repeated value.
    """
    if not isinstance(node.content, list):
        raise PipelineError(
            f"the values of {path} must be a list or named alternatives, not {node.kind}",
            where=str(node.place),
            fix=f"write `{path}: [value, value]`",
        )
    choices: dict[str, Alternative] = {}
    for value in node.content:
        label = _value_label(value)
        if label in choices:
            raise PipelineError(
                f"{path} has the value {label} twice", where=str(value.place), fix="remove one"
            )
        choices[label] = Alternative(label, (Change(path, value),))
    if not choices:
        raise PipelineError(
            f"{path} has no values", where=str(node.place), fix="list two or more, or remove it"
        )
    return Variation(path, tuple(choices.values()))


def alternatives(name: str, node: Node) -> Variation:
    """Return the variation over a mapping from labels to settings with their values.

    Raises:
        PipelineError: an alternative is not a mapping, or none changes a setting.
    """
    assert isinstance(node.content, dict)
    choices = []
    for label, settings in node.content.items():
        if not isinstance(settings.content, dict):
            raise PipelineError(
                f"the alternative {label!r} of {name} must map settings to values, "
                f"not {settings.kind}",
                where=str(settings.place),
                fix="for example {priors.stereo.path: model.onnx}; {} changes nothing",
            )
        changes = tuple(Change(path, value) for path, value in settings.content.items())
        choices.append(Alternative(label, changes))
    if not any(choice.changes for choice in choices):
        raise PipelineError(
            f"no alternative of {name} changes anything",
            where=str(node.place),
            fix="list the settings that each alternative changes",
        )
    return Variation(name, tuple(choices))


def scene_choices(root: Node, written: tuple[Node, ...]) -> tuple[Alternative, ...]:
    """Return the listed scenes, or the pipeline's own scene if none is listed.

    A text without a slash is a folder in STEREOGS_DATA, with a slash a path; both replace the `path` of the
    pipeline's loader. A mapping replaces the loader.

    Raises:
        PipelineError: an entry of another type, or two scenes with one label.
    """
    if not written:
        assert isinstance(root.content, dict)
        return (Alternative(_scene_label(root.content["scene"]), ()),)
    scenes: dict[str, Alternative] = {}
    for node in written:
        label = _scene_label(node)
        if label in scenes:
            raise PipelineError(
                f"two scenes are called {label!r}",
                where=str(node.place),
                fix="remove one, or give it another name: {use: LOADER, name: ..., path: ...}",
            )
        scenes[label] = Alternative(label, (_scene_change(node),))
    return tuple(scenes.values())


def is_path(scene: str) -> bool:
    """Whether a text has a separator of folders, which may be a backslash on Windows."""
    return "/" in scene or os.sep in scene


def _scene_change(node: Node) -> Change:
    if isinstance(node.content, str):
        path = node.content if is_path(node.content) else f"${{{DATA}}}/{node.content}"
        return Change("scene.path", Node(path, node.place))
    if not isinstance(node.content, dict):
        raise PipelineError(
            f"a scene must be a name, a path or a loader, not {node.kind}",
            where=str(node.place),
            fix="write for example llff_fern, ./photos, or {use: procedural}",
        )
    return Change("scene", node)


def _scene_label(node: Node) -> str:
    """Return the loader's `name`, otherwise the last part of its path, otherwise the loader."""
    if isinstance(node.content, str):
        return PurePath(node.content).name
    content = node.content if isinstance(node.content, dict) else {}
    path = content.get("path")
    if "name" not in content and path is not None and isinstance(path.content, str):
        return PurePath(path.content).name
    return (item_names(node) or ["scene"])[0]


def _value_label(value: Node) -> str:
    """Return a scalar as it is, a component's name, or JSON."""
    if isinstance(value.content, str):
        return value.content
    names = item_names(value)
    return names[0] if names else json.dumps(value.as_written(), ensure_ascii=False)
