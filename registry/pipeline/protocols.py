"""Evaluation protocols: the conditions under which published numbers are comparable.

Packages provide them as YAML files through the entry-point group `stereogs.protocols`. A pipeline names one,
`protocol: llff-3`. The protocol fixes settings of the scene loader and of the metrics. A pipeline with other
values is refused, unless it lists them:

    protocol: {use: blender-8, modified: [scene.background]}

Results then carry the modification, and are only compared with results that carry the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from ..contract.component import Settings
from ..errors import PipelineError
from ..messages.suggestions import did_you_mean, listing
from .edits import expand, item_names
from .ready import PROTOCOLS, only_file, packaged_files
from .settings_check import plain, validate_settings
from .yaml_source import Node, Place, parse

View = TypeVar("View")
MOST_SCORED = 48
"""Training views that are scored if there are test views; all would take time quadratic in the views."""


class Protocol(Settings):
    """One protocol. `loaders` and `metrics` are imposed on a pipeline; the rest describes them."""

    name: str
    """As a pipeline writes it, for example "llff-3"."""
    title: str
    """The data set and the number of training views, for people."""
    scenes: tuple[str, ...]
    """The scenes that published averages include."""
    train_views: int
    """Number of views that a method may train on."""
    split: str
    """Which views train and which test."""
    scale: str
    """The size that images are trained and scored at."""
    image_source: Literal["folder", "resize"]
    """"folder": the small images of the data set; "resize": made from the large images."""
    filter: str | None
    """The filter that makes images smaller, where `image_source` is "resize"."""
    background: Literal["none", "white", "black"]
    """The background of transparent images, in photographs and renders."""
    masks: str | None
    """Which pixels count in metrics; null means all."""
    notes: str | None = None
    """Differences among published papers."""
    loaders: dict[str, dict[str, Any]]
    """Settings of the scene loader, for each loader that can follow the protocol."""
    metrics: tuple[dict[str, Any], ...]
    """The metrics that must be measured, with their fixed settings."""


class ProtocolChoice(Settings):
    """The section `protocol` of a pipeline."""

    use: str
    """The protocol's name."""
    modified: tuple[str, ...] = ()
    """Settings in which the pipeline departs from it, for example "scene.background"."""


@dataclass(frozen=True)
class AppliedProtocol:
    """A protocol as a pipeline follows it.

    Args:
        protocol: the protocol itself.
        modified: the settings in which the pipeline departs from it, with their values.
    """

    protocol: Protocol
    modified: dict[str, Any]

    @property
    def written(self) -> str | dict[str, Any]:
        """As in a pipeline file."""
        if not self.modified:
            return self.protocol.name
        return {"use": self.protocol.name, "modified": list(self.modified)}

    def record(self) -> dict[str, Any]:
        """All of it as plain JSON values, for results."""
        return {**self.protocol.model_dump(mode="json"), "modified": self.modified}


def scored(train: Sequence[View], test: Sequence[View]) -> list[View]:
    """Return the training views to score: all, or with test views at most `MOST_SCORED`, evenly spaced."""
    count = min(len(train), MOST_SCORED) if test else len(train)
    return [train[index * len(train) // count] for index in range(count)]


def protocol_names() -> tuple[str, ...]:
    """Return the names of the installed protocols, sorted."""
    return tuple(packaged_files(PROTOCOLS))


def load_protocol(name: str) -> Protocol:
    """Return the protocol of that name.

    Raises:
        PipelineError: the name is unknown, or several packages provide it.
    """
    return validate_settings(Protocol, _read(name, Place("protocol")), "protocol")


def _read(name: str, place: Place) -> Node:
    """Return a protocol's file as a tree; `place` names the protocol."""
    files = packaged_files(PROTOCOLS)
    if name not in files:
        raise place.error(
            f"unknown protocol {name!r}{did_you_mean(name, files)}",
            fix=f"protocols: {listing(files)}; or remove `protocol`",
        )
    file = only_file(f"the protocol {name!r}", files[name], place, "uninstall one of them")
    return parse(file.read_text("utf-8"), f"protocols/{file.name}")


def apply_protocol(sections: dict[str, Node]) -> AppliedProtocol | None:
    """Impose the protocol that a pipeline names on its scene and metrics, in place.

    Returns:
        The protocol and how it was modified; None if the pipeline names none.

    Raises:
        PipelineError: the protocol is unknown or does not cover the scene loader, a metric of it is
            disabled, a setting contradicts it (with both places), or `modified` names a setting that
            it does not fix.
    """
    node = sections.get("protocol")
    if node is None or node.content is None:
        return None
    content = {"use": node} if isinstance(node.content, str) else node.content
    if not isinstance(content, dict):
        raise node.place.error(
            f"a protocol is a name, not {node.kind}",
            fix=f"protocols: {listing(protocol_names())}; or remove `protocol`",
        )
    choice = validate_settings(ProtocolChoice, Node(content, node.place), "protocol")
    source = _read(choice.use, node.place)
    protocol = validate_settings(Protocol, source, "protocol")
    fixed: list[str] = []
    modified: dict[str, Any] = {}
    for label, mapping, rules in _ruled(sections, protocol, source, node.place):
        for key, rule in rules.items():
            path = f"{label}.{key}"
            if key != "use":
                fixed.append(path)
            written = mapping.setdefault(key, rule)
            value = plain(written)
            if value != plain(rule):
                if path not in choice.modified:
                    raise _contradiction(path, written, rule, protocol.name)
                modified[path] = value
    unknown = [path for path in choice.modified if path not in fixed]
    if unknown:
        raise node.at(("modified",)).place.error(
            f"the protocol does not fix {unknown[0]!r}{did_you_mean(unknown[0], fixed)}",
            fix=f"remove it from `modified`; the protocol fixes {listing(fixed)}",
        )
    return AppliedProtocol(protocol, modified)


def _ruled(
    sections: dict[str, Node], protocol: Protocol, source: Node, place: Place
) -> Iterator[tuple[str, dict[str, Node], dict[str, Node]]]:
    """Yield each component that the protocol fixes: label, settings, fixed settings."""
    scene = sections.get("scene")
    if scene is not None and scene.content is not None:
        mapping = expand(scene)
        use = mapping["use"].content if "use" in mapping else None
        if use not in protocol.loaders:
            raise scene.place.error(
                f"the protocol {protocol.name!r} does not cover the scene loader {use!r}",
                fix=f"use one of {listing(protocol.loaders)}, or no protocol: --set protocol=null",
            )
        yield "scene", mapping, expand(source.at(("loaders", str(use))))
    metrics = sections.get("metrics")
    if metrics is None or metrics.content is None:
        metrics = sections["metrics"] = Node([], place)
    if not isinstance(metrics.content, list):
        return  # refused with the other sections
    for index, rule in enumerate(protocol.metrics):
        name, rules = rule["use"], source.at(("metrics", index))
        item = next((item for item in metrics.content if item_names(item)[:1] == [name]), None)
        if item is None:
            item = Node(name, rules.place)
            metrics.content.append(item)
        mapping = expand(item)
        if "enabled" in mapping and mapping["enabled"].content is False:
            raise mapping["enabled"].place.error(
                f"the protocol {protocol.name!r} measures {name!r}, which is disabled",
                fix="enable it, or use no protocol: --set protocol=null",
            )
        yield f"metrics.{name}", mapping, expand(rules)


def _contradiction(path: str, written: Node, rule: Node, protocol: str) -> PipelineError:
    return PipelineError(
        f"{path} is {plain(written)!r}, but the protocol {protocol!r} fixes {plain(rule)!r}",
        where=f"{written.place} and {rule.place}",
        fix=f"remove `{path.rpartition('.')[2]}`, use no protocol (--set protocol=null), or declare the "
        f"modification: protocol: {{use: {protocol}, modified: [{path}]}}",
    )
