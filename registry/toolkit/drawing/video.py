"""Frames to a video where imageio-ffmpeg is installed, else to numbered pictures."""

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
    """Write `target`.mp4, or pictures into the folder `target` if no encoder is installed.

    Args:
        frames: at least one, each `[H, W, 3]` in [0, 1].

    Returns:
        What was written, and a few words that say which of the two it is.
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
    """The frame with its last row and column twice where H.264's common colour format wants even sizes."""
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
