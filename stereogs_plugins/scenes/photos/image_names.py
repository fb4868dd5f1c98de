"""What photographs are called inside a model: their index, whatever their files are called."""

from __future__ import annotations

from pathlib import PurePath


def image_name(index: int) -> str:
    """What a photograph is called inside a model."""
    return f"{index:04d}.png"


def image_index(name: str) -> int:
    """The inverse of `image_name`."""
    return int(PurePath(name).stem)
