"""`photos`: a folder of photographs without cameras, which COLMAP estimates."""

from .loader import PhotosScene, stereogs_register_scenes

__all__ = ["PhotosScene", "stereogs_register_scenes"]
