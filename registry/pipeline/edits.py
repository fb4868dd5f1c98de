"""Changes from the command line: `--set a.b=c` and `--disable NAME`, applied to the YAML tree."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..contract.components import SceneLoader
from ..contract.hook_points import PIPELINE_POINTS
from ..discovery import Plugins
from ..messages.suggestions import did_you_mean, listing
from ..recognition import recognize, recognizing
from .ready import packager
from .settings_check import plain
from .yaml_source import Node, Place, parse

SECTIONS = {point.section: point for point in PIPELINE_POINTS}
TOP_LEVEL = ("name", "protocol", *SECTIONS, "training")
"""The keys of a pipeline file."""
_log = logging.getLogger("stereogs.pipeline")


def apply_overrides(root: Node, overrides: Sequence[str], plugins: Plugins) -> None:
    """Apply several overrides, in place.

    If they change `scene.path` but not the loader, and the written loader does not recognize the new
    folder, the only loader that does replaces it. The settings of the written loader are then dropped.

    Raises:
        ExplainedError: see `apply_override`; no loader is written, and none or several recognize the folder.
    """
    keys = [text.partition("=")[0].strip() for text in overrides]
    left = list(overrides)
    if "scene.path" in keys and not {"scene", "scene.use"} & {*keys}:
        apply_override(root, left.pop(keys.index("scene.path")))
        _choose_loader(root.at(("scene",)), plugins)
    for text in left:
        apply_override(root, text)


def _choose_loader(scene: Node, plugins: Plugins) -> None:
    written = expand(scene)
    path = written["path"]
    folder = Path(str(plain(path))).expanduser()
    if not folder.is_dir():
        return
    if "use" not in written:
        chosen = recognize(folder, plugins)
    else:
        use = written["use"]
        owner = packager(use.place.source)
        current = plugins.find(SECTIONS["scene"], str(plain(use)), owner).component
        if issubclass(current, SceneLoader) and current.recognizes(folder):
            return
        others = recognizing(folder, plugins)
        if len(others) != 1:
            return
        chosen = others[0]
    scene.content = {"use": Node(chosen.use, path.place), "path": path}
    _log.info("%s is read by the scene loader %s", folder, chosen.name)


def apply_override(root: Node, text: str) -> None:
    """Apply one `a.b=c` in place. Items of a list are addressed by `name`, or else by `use`.

    Raises:
        PipelineError: there is no `=`, a section or item is unknown, or the path goes through a scalar.
    """
    place = Place(f"--set {text}")
    path, separator, value = text.partition("=")
    node = parse(value, place.source, has_lines=False)
    set_value(root, path.strip() if separator else "", node, place)


def set_value(root: Node, path: str, value: Node, place: Place) -> None:
    """`apply_override` for a parsed value at a dotted path; `place` is that of the change, for errors."""
    keys = path.split(".")
    if not all(keys):
        raise place.error(
            "an override must look like a.b=value", fix="for example --set training.iterations=5000"
        )
    check_section(keys[0], place)
    node = root
    for depth, key in enumerate(keys):
        node = _child(node, key, keys[:depth], place)
    node.content, node.place = value.content, value.place


def check_section(name: str, place: Place) -> None:
    """Raise a PipelineError unless a pipeline has a section of that name."""
    if name not in TOP_LEVEL:
        raise place.error(
            f"a pipeline has no section {name!r}{did_you_mean(name, TOP_LEVEL)}",
            fix=f"sections: {listing(TOP_LEVEL)}",
        )


def _child(node: Node, key: str, path: list[str], place: Place) -> Node:
    """Return an item of a list, or an entry of a mapping, which is created; `path` leads to the node."""
    if isinstance(node.content, list):
        items: dict[str, Node] = {}
        for item in node.content:
            for name in item_names(item)[:1]:
                items.setdefault(name, item)
        if key not in items:
            raise place.error(
                f"{'.'.join(path)} has no item {key!r}{did_you_mean(key, items)}",
                fix=f"items: {listing(items)}",
            )
        return items[key]
    if isinstance(node.content, str) and len(path) in (1, 2) and path[0] in SECTIONS:
        expand(node)  # a component written as a bare name
    if not isinstance(node.content, dict):
        raise place.error(f"{'.'.join(path)} is {node.kind} and has no parts to set")
    if key not in node.content or node.content[key].content is None:
        node.content[key] = Node({}, place)
    return node.content[key]


def disable(root: Node, name: str) -> None:
    """Disable every component called `name`, by its `name` or its `use`, in place.

    Raises:
        PipelineError: the pipeline has no such component, or the component is required.
    """
    place = Place(f"--disable {name}")
    found = [(section, item) for section, item in component_items(root) if name in item_names(item)]
    if not found:
        known = dict.fromkeys(n for _, item in component_items(root) for n in item_names(item))
        raise place.error(
            f"the pipeline has no component {name!r}{did_you_mean(name, known)}",
            fix=f"components: {listing(known)}",
        )
    for section, item in found:
        if SECTIONS[section].required:
            raise place.error(
                f"{name!r} is the {SECTIONS[section].title}, which a pipeline requires",
                fix=f"choose another one with --set {section}.use=...",
            )
        expand(item)["enabled"] = Node(False, place)


def component_items(root: Node) -> Iterator[tuple[str, Node]]:
    """Yield each written component with its section, in the order of the hook points."""
    if not isinstance(root.content, dict):
        return
    for section in SECTIONS:
        node = root.content.get(section)
        if node is not None and node.content is not None:
            for item in node.content if isinstance(node.content, list) else [node]:
                yield section, item


def item_names(item: Node) -> list[str]:
    """Return the names of a component: its `name` if it has one, and its `use`."""
    if isinstance(item.content, str):
        return [bare_name(item.content)]
    if not isinstance(item.content, dict):
        return []
    values = (item.content[key].content for key in ("name", "use") if key in item.content)
    return [bare_name(value) for value in values if isinstance(value, str)]


def bare_name(use: str) -> str:
    """Return the name of a component without its package."""
    return use.rpartition("/")[2]


def expand(item: Node) -> dict[str, Node]:
    """Return the mapping of a component; a bare name becomes `{use: name}` first, in place."""
    if isinstance(item.content, str):
        item.content = {"use": Node(item.content, item.place)}
    if not isinstance(item.content, dict):
        raise item.place.error(
            f"a component is a name or a mapping with `use`, not {item.kind}",
            fix="write the name alone, or {use: NAME, ...}",
        )
    return item.content
