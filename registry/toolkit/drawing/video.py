"""Write frames as a video, or as numbered images without imageio-ffmpeg."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from itertools import chain
from pathlib import Path

import torch
from torch import Tensor

from ...system.files import replacing
from .pictures import save_png, to_bytes

FRAMES_PER_SECOND = 30


def write_video(frames: Iterable[Tensor], target: Path) -> tuple[Path, str]:
    """Write `target`.mp4, or images into the folder `target` if no encoder is installed.

    Args:
        frames: At least one frame `[H, W, 3]` in [0, 1].

    Returns:
        Path of the file or folder, and a short description of it.
    """
    try:
        import imageio_ffmpeg  # type: ignore[import-untyped]
    except ImportError:
        target.mkdir(parents=True, exist_ok=True)
        for number, frame in enumerate(frames):
            save_png(frame, target / f"{number:04d}.png")
        return target, "pictures (no video: pip install 'stereogs-plugins[video]')"
    remaining = iter(frames)
    first = next(remaining)
    height, width = _even(first).shape[:2]
    video = target.with_suffix(".mp4")
    with replacing(video) as temporary:
        writer = imageio_ffmpeg.write_frames(
            str(temporary),
            (width, height),
            fps=FRAMES_PER_SECOND,
            quality=8,
            macro_block_size=2,
            output_params=["-f", "mp4"],
            ffmpeg_log_level="error",
        )
        _feed(writer, chain([first], remaining))
    return video, "MP4 video"


def _even(frame: Tensor) -> Tensor:
    """Repeat the last row or column of odd sizes; H.264's common color format requires even sizes."""
    height, width = frame.shape[:2]
    rows = torch.arange(height + height % 2).clamp(max=height - 1)
    columns = torch.arange(width + width % 2).clamp(max=width - 1)
    return frame[rows][:, columns]


def _feed(writer: Generator[None, bytes | None], frames: Iterable[Tensor]) -> None:
    writer.send(None)
    try:
        for frame in frames:
            writer.send(to_bytes(_even(frame)).tobytes())
    finally:
        writer.close()
