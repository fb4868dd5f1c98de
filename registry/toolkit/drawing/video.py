"""Write frames as a video, or as numbered images without imageio-ffmpeg."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ...system.files import replacing
from .pictures import save_png, to_bytes

FRAMES_PER_SECOND = 30


def write_video(frames: Iterable[Tensor], target: Path) -> tuple[Path, str]:
    """Write `target`.mp4, or images into the folder `target`, in place of earlier ones, without an encoder.

    Args:
        frames: At least one frame `[H, W, 3]` in [0, 1].

    Returns:
        Path of the file or folder, and a short description of it.
    """
    try:
        import imageio_ffmpeg  # type: ignore[import-untyped]
    except ImportError:
        target.mkdir(parents=True, exist_ok=True)
        for earlier in target.glob("*.png"):
            earlier.unlink()
        for number, frame in enumerate(frames):
            save_png(frame, target / f"{number:04d}.png")
        return target, "pictures (no video: pip install 'stereogs-plugins[video]')"
    remaining = map(_pixels, frames)
    first = next(remaining)
    video = target.with_suffix(".mp4")
    with replacing(video) as temporary:
        writer = imageio_ffmpeg.write_frames(
            str(temporary),
            (first.shape[1], first.shape[0]),
            fps=FRAMES_PER_SECOND,
            quality=8,
            macro_block_size=2,
            output_params=["-f", "mp4"],
            ffmpeg_log_level="error",
        )
        with closing(writer):
            writer.send(None)
            for pixels in chain([first], remaining):
                writer.send(pixels.tobytes())
    return video, "MP4 video"


def _pixels(frame: Tensor) -> NDArray[np.uint8]:
    """Convert a frame to bytes with even sides, which H.264's common color format requires."""
    pixels = to_bytes(frame)
    height, width = pixels.shape[:2]
    return np.pad(pixels, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
