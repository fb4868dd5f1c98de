"""`photos`: a folder of photographs without cameras, which COLMAP estimates; `video`: a video file."""

from registry import Register, hookimpl

from .loader import PhotosScene
from .video_file import VideoScene

__all__ = ["PhotosScene", "VideoScene", "stereogs_register_scenes"]


@hookimpl
def stereogs_register_scenes(register: Register[PhotosScene | VideoScene]) -> None:
    register("photos", PhotosScene)
    register("video", VideoScene)
