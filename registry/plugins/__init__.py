"""Installed plugins: found through entry points, imported when they are named."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .commands import COMMANDS, verbs
    from .discovery import (
        GROUP,
        Offer,
        Plugins,
        installed_entries,
        offered_name,
        recognize,
        scene_loaders,
    )
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "COMMANDS",
    "GROUP",
    "Offer",
    "Plugins",
    "installed_entries",
    "offered_name",
    "recognize",
    "scene_loaders",
    "verbs",
]
