"""A protocol at work on a pipeline.

A pipeline names one, `protocol: llff-3`. It fills in the settings of the scene loader and of the metrics
that it fixes. A pipeline that says otherwise is refused, unless it owns up to it:

    protocol: {use: blender-8, modified: [scene.background]}

Results then carry the modification, and are compared with none that lacks it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..contract.component import Settings
from ..errors import PipelineError
from ..messages.suggestions import did_you_mean, listing
from .edits import expand, item_names
from .protocols import Protocol, protocol_names, read_protocol
from .settings_check import plain, validate_settings
from .yaml_source import Node


class ProtocolChoice(Settings):
    """What a pipeline says of its protocol."""

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
        """As a pipeline file says it."""
        if not self.modified:
            return self.protocol.name
        return {"use": self.protocol.name, "modified": list(self.modified)}

    def record(self) -> dict[str, Any]:
        """All of it as plain JSON values, for results."""
        return {**self.protocol.model_dump(mode="json"), "modified": self.modified}


def apply_protocol(sections: dict[str, Node]) -> AppliedProtocol | None:
    """Impose the protocol that a pipeline names on its scene and metrics, in place.

    Returns:
        The protocol and how it was modified; None if the pipeline names none.

    Raises:
        PipelineError: an unknown protocol, a scene loader that it does not cover, a metric of it that
            is switched off, a setting that contradicts it, with both places, or a modification of
            what it does not fix.
    """
    node = sections.get("protocol")
    if node is None or node.content is None:
        return None
    source, choice = _chosen(node)
    rules = _Rules(validate_settings(Protocol, source, "protocol"), choice.modified)
    if "scene" in sections and sections["scene"].content is not None:
        rules.impose_on_scene(sections["scene"], source)
    metrics = sections.get("metrics")
    if metrics is None or metrics.content is None:
        metrics = sections["metrics"] = Node([], node.place)
    if isinstance(metrics.content, list):  # anything else is refused with the other sections
        for index, rule in enumerate(rules.protocol.metrics):
            rules.impose_on_metrics(metrics.content, rule["use"], source.at(("metrics", index)))
    unknown = [path for path in choice.modified if path not in rules.fixed]
    if unknown:
        raise PipelineError(
            f"the protocol does not fix {unknown[0]!r}{did_you_mean(unknown[0], rules.fixed)}",
            where=str(node.at(("modified",)).place),
            fix=f"remove it from `modified`; the protocol fixes {listing(rules.fixed)}",
        )
    return AppliedProtocol(rules.protocol, rules.modified)


def _chosen(node: Node) -> tuple[Node, ProtocolChoice]:
    """The protocol's own file, and the pipeline's choice of it."""
    mapping = {"use": node} if isinstance(node.content, str) else node.content
    if not isinstance(mapping, dict):
        raise PipelineError(
            f"a protocol is a name, not {node.kind}",
            where=str(node.place),
            fix=f"protocols: {listing(protocol_names())}; or remove `protocol`",
        )
    choice = validate_settings(ProtocolChoice, Node(mapping, node.place), "protocol")
    return read_protocol(choice.use, str(node.place)), choice


class _Rules:
    """A protocol at work on one pipeline.

    Args:
        allowed: settings that may contradict it.

    Attributes:
        fixed: the settings that it has imposed, by dotted name.
        modified: those that contradict it, with the pipeline's values.
    """

    def __init__(self, protocol: Protocol, allowed: tuple[str, ...]) -> None:
        self.protocol = protocol
        self.fixed: list[str] = []
        self.modified: dict[str, Any] = {}
        self._allowed = allowed

    def impose_on_scene(self, scene: Node, source: Node) -> None:
        mapping = expand(scene)
        use = mapping["use"].content if "use" in mapping else None
        if use not in self.protocol.loaders:
            raise PipelineError(
                f"the protocol {self.protocol.name!r} says nothing about the scene loader {use!r}",
                where=str(scene.place),
                fix=f"use one of {listing(self.protocol.loaders)}, or do without: "
                "--set protocol=null",
            )
        self._impose(mapping, source.at(("loaders", str(use))), "scene")

    def impose_on_metrics(self, written: list[Node], name: str, source: Node) -> None:
        item = next((item for item in written if item_names(item)[:1] == [name]), None)
        if item is None:
            item = Node(name, source.place)
            written.append(item)
        mapping = expand(item)
        if "enabled" in mapping and mapping["enabled"].content is False:
            raise PipelineError(
                f"the protocol {self.protocol.name!r} measures {name!r}, which is switched off",
                where=str(mapping["enabled"].place),
                fix="leave it on, or do without the protocol: --set protocol=null",
            )
        self._impose(mapping, source, f"metrics.{name}")

    def _impose(self, mapping: dict[str, Node], wanted: Node, label: str) -> None:
        """Fill in settings; one that is written already must agree, or be allowed not to."""
        assert isinstance(wanted.content, dict)
        for key, node in wanted.content.items():
            path = f"{label}.{key}"
            if key != "use":
                self.fixed.append(path)
            written = mapping.setdefault(key, node)
            value = plain(written)
            if value == plain(node):
                continue
            if path not in self._allowed:
                raise PipelineError(
                    f"{path} is {value!r}, but the protocol {self.protocol.name!r} fixes "
                    f"{plain(node)!r}",
                    where=f"{written.place} and {node.place}",
                    fix=f"remove `{key}`, do without the protocol (--set protocol=null), or own up: "
                    f"protocol: {{use: {self.protocol.name}, modified: [{path}]}}",
                )
            self.modified[path] = value
