"""One component with settings from the command line, as a pipeline would have it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..pipeline.edits import apply_override, expand
from ..pipeline.pipeline import Item
from ..pipeline.schedule import HostSettings
from ..pipeline.settings_check import validate_settings
from ..pipeline.yaml_source import Node, Place
from ..plugins.discovery import Offer

COMMAND_LINE = Place("the command line")


def single_item(
    offer: Offer, overrides: Sequence[str], written: Mapping[str, Node] | None = None
) -> Item:
    """The item of a component that no pipeline names.

    Args:
        overrides: `section.key=value`, see `qualified`.
        written: settings that it has before that.

    Raises:
        PipelineError: an override is malformed, or the settings are wrong.
    """
    section = offer.point.section
    root = Node({section: Node(dict(written or {}), COMMAND_LINE)}, COMMAND_LINE)
    for text in overrides:
        apply_override(root, text)
    assert isinstance(root.content, dict)
    settings = validate_settings(
        offer.settings_type, Node({**expand(root.content[section])}, COMMAND_LINE), section
    )
    return Item(offer.name, settings, HostSettings(use=offer.name), offer, COMMAND_LINE)


def qualified(change: str, section: str) -> str:
    """`key=value` as `section.key=value`; one that says the section already stays as it is."""
    start = f"{section}."
    return change if change.startswith(start) else start + change
