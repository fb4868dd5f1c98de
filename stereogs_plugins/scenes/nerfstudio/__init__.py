"""`nerfstudio`: a capture in nerfstudio's format, `transforms.json` (Tancik et al. 2023)."""

from .loader import NerfstudioScene, stereogs_register_scenes

__all__ = ["NerfstudioScene", "stereogs_register_scenes"]
