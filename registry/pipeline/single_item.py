"""The item of a component that no pipeline names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..discovery import Offer
from .edits import apply_override, expand
from .pipeline import Item
from .schedule import HostSettings
from .settings_check import validate_settings
from .yaml_source import Node, Place

COMMAND_LINE = Place("the command line")


def single_item(
    offer: Offer, changes: Sequence[str] = (), written: Mapping[str, Node] | None = None
) -> Item:
    """Return the item of a component that no pipeline names.

    Args:
        changes: `key=value` or `section.key=value`, settings of the component.
        written: settings that the changes apply to.

    Raises:
        PipelineError: a change is malformed, or a setting is wrong.
    """
    section = offer.point.section
    root = Node({section: Node(dict(written or {}), COMMAND_LINE)}, COMMAND_LINE)
    for text in changes:
        apply_override(root, qualified(text, section))
    settings = validate_settings(
        offer.settings_type, Node(expand(root.at((section,))), COMMAND_LINE), section
    )
    return Item(offer.name, settings, HostSettings(use=offer.name), offer, COMMAND_LINE)


def qualified(change: str, section: str) -> str:
    """Return `key=value` as `section.key=value`, which may be written so already."""
    return f"{section}.{change.removeprefix(f'{section}.')}"
