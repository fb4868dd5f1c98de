"""`procedural`: a furnished room, ray-cast here, with exact poses and depth; nothing to download."""

from .loader import ProceduralScene, stereogs_register_scenes

__all__ = ["ProceduralScene", "stereogs_register_scenes"]
