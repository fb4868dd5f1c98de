"""Changes from the command line: `--set a.b=c` and `--disable NAME`, applied to the YAML tree."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..contract.components import SceneLoader
from ..contract.hook_points import PIPELINE_POINTS
from ..errors import PipelineError
from ..messages.suggestions import did_you_mean, listing
from ..plugins.discovery import Plugins
from ..plugins.recognition import recognize, recognizing
from .settings_check import plain
from .yaml_source import Node, Place, parse

SECTIONS = {point.section: point for point in PIPELINE_POINTS}
TOP_LEVEL = ("name", "protocol", *SECTIONS, "training")
"""The keys of a pipeline file."""
_SCENE = "scene"
_PATH = f"{_SCENE}.path"
_log = logging.getLogger("stereogs.pipeline")


def apply_overrides(root: Node, overrides: Sequence[str], plugins: Plugins) -> None:
    """Apply several, in place.

    Where they put another folder into the scene and no loader, the folder is read by a loader that knows
    it by its content: by the one that is written, or by the only other. The settings that are written
    were for the written one and fall away with it.

    Raises:
        ExplainedError: see `apply_override`; no loader is written, and none or several know the folder.
    """
    keys = [text.partition("=")[0].strip() for text in overrides]
    left = list(overrides)
    if _PATH in keys and not {_SCENE, f"{_SCENE}.use"} & {*keys}:
        apply_override(root, left.pop(keys.index(_PATH)))
        _choose_loader(root, plugins)
    for text in left:
        apply_override(root, text)


def _choose_loader(root: Node, plugins: Plugins) -> None:
    assert isinstance(root.content, dict)
    scene = root.content[_SCENE]
    written = expand(scene)
    folder = Path(str(plain(written["path"]))).expanduser()
    if not folder.is_dir():
        return
    if "use" not in written:
        chosen = recognize(folder, plugins)
    else:
        current = plugins.find(SECTIONS[_SCENE], str(plain(written["use"]))).component
        others = []
        if not (issubclass(current, SceneLoader) and current.recognizes(folder)):
            others = recognizing(folder, plugins)
        if len(others) != 1:
            return
        (chosen,) = others
    place = written["path"].place
    scene.content = {"use": Node(chosen.name, place), "path": written["path"]}
    _log.info("%s is read by the scene loader %s", folder, chosen.name)


def apply_override(root: Node, text: str) -> None:
    """Apply one `a.b=c` in place. Items of a list are addressed by `name`, or else by `use`.

    Raises:
        PipelineError: no `=`; an unknown section or item; a path through something that has no parts.
    """
    place = Place(f"--set {text}")
    path, separator, value = text.partition("=")
    if not separator:
        raise _malformed(place)
    set_value(root, path.strip(), parse(value, place.source, has_lines=False), place)


def set_value(root: Node, path: str, value: Node, place: Place) -> None:
    """Put a value at a dotted path, in place; `apply_override` for a value that is parsed already.

    Args:
        place: where the change was written, for errors.

    Raises:
        PipelineError: see `apply_override`.
    """
    keys = path.split(".")
    if not all(keys):
        raise _malformed(place)
    if keys[0] not in TOP_LEVEL:
        raise PipelineError(
            f"a pipeline has no section {keys[0]!r}{did_you_mean(keys[0], TOP_LEVEL)}",
            where=str(place),
            fix=f"sections: {listing(TOP_LEVEL)}",
        )
    node = root
    for depth, key in enumerate(keys[:-1]):
        node = _descend(node, key, keys[: depth + 1], place)
    if isinstance(node.content, list):
        item = _item(node, keys[-1], keys, place)
        item.content, item.place = value.content, value.place
    else:
        _mapping(node, keys[:-1], place)[keys[-1]] = value


def disable(root: Node, name: str) -> None:
    """Switch off every component called `name`, by its alias or its `use`, in place.

    Raises:
        PipelineError: the pipeline has no such component, or cannot do without it.
    """
    place = Place(f"--disable {name}")
    found = False
    known: list[str] = []
    for section, item in component_items(root):
        names = item_names(item)
        known.extend(names)
        if name not in names:
            continue
        if SECTIONS[section].required:
            raise PipelineError(
                f"{name!r} is the {SECTIONS[section].title}, which a pipeline cannot do without",
                where=str(place),
                fix=f"choose another one with --set {section}.use=...",
            )
        expand(item)["enabled"] = Node(False, place)
        found = True
    if not found:
        raise PipelineError(
            f"the pipeline has no component {name!r}{did_you_mean(name, known)}",
            where=str(place),
            fix=f"components: {listing(dict.fromkeys(known))}",
        )


def component_items(root: Node) -> Iterator[tuple[str, Node]]:
    """Each component that is written, with its section, in the order of the hook points."""
    if not isinstance(root.content, dict):
        return
    for section in SECTIONS:
        node = root.content.get(section)
        if node is None or node.content is None:
            continue
        for item in node.content if isinstance(node.content, list) else [node]:
            yield section, item


def item_names(item: Node) -> list[str]:
    """What a component answers to: its alias if it has one, and its `use`."""
    if isinstance(item.content, str):
        return [item.content]
    if not isinstance(item.content, dict):
        return []
    values = (item.content[key].content for key in ("name", "use") if key in item.content)
    return [value for value in values if isinstance(value, str)]


def expand(item: Node) -> dict[str, Node]:
    """The component's mapping; a bare name becomes `{use: name}` first."""
    if isinstance(item.content, str):
        item.content = {"use": Node(item.content, item.place)}
    if not isinstance(item.content, dict):
        raise PipelineError(
            f"a component is a name or a mapping with `use`, not {item.kind}",
            where=str(item.place),
            fix="write the name alone, or {use: NAME, ...}",
        )
    return item.content


def _malformed(place: Place) -> PipelineError:
    return PipelineError(
        "an override must look like a.b=value",
        where=str(place),
        fix="for example --set training.iterations=5000",
    )


def _descend(node: Node, key: str, path: list[str], place: Place) -> Node:
    if isinstance(node.content, list):
        return _item(node, key, path, place)
    mapping = _mapping(node, path[:-1], place)
    if key not in mapping or mapping[key].content is None:
        mapping[key] = Node({}, place)
    return mapping[key]


def _item(node: Node, name: str, path: list[str], place: Place) -> Node:
    assert isinstance(node.content, list)
    known: list[str] = []
    for item in node.content:
        names = item_names(item)
        if names and name == names[0]:
            return item
        known.extend(names[:1])
    raise PipelineError(
        f"{'.'.join(path[:-1])} has no item {name!r}{did_you_mean(name, known)}",
        where=str(place),
        fix=f"items: {listing(known)}",
    )


def _mapping(node: Node, path: list[str], place: Place) -> dict[str, Node]:
    if isinstance(node.content, str) and path[0] in SECTIONS and len(path) <= 2:
        return expand(node)  # a component written as a bare name
    if not isinstance(node.content, dict):
        raise PipelineError(
            f"{'.'.join(path)} is {node.kind} and has no parts to set", where=str(place)
        )
    return node.content
