"""`photos`: a folder of pictures and nothing else; their cameras are found by COLMAP."""

from .loader import PhotosScene, stereogs_register_scenes

__all__ = ["PhotosScene", "stereogs_register_scenes"]
