"""`procedural`: a ray-cast furnished room with exact poses and depth; needs no download."""

from .loader import ProceduralScene, stereogs_register_scenes

__all__ = ["ProceduralScene", "stereogs_register_scenes"]
