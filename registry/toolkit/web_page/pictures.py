"""Pictures inside a page, alone or side by side."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL import Image

LONGEST_SIDE = 1560
"""Pixels; larger pictures are reduced, so that a page can be sent by mail."""
_QUALITY = 85


def image(source: Path | Image.Image, alt: str, longest_side: int = LONGEST_SIDE) -> str:
    """A picture as JPEG inside the page, reduced so that no side has more than so many pixels."""
    from PIL import Image

    if isinstance(source, Path):
        with Image.open(source) as opened:
            return image(opened, alt, longest_side)
    picture = source.convert("RGB")
    picture.thumbnail((longest_side, longest_side))
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=_QUALITY)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<img alt="{escape(alt)}" src="data:image/jpeg;base64,{data}">'


def figure(caption: str, content: str) -> str:
    """Images, one below the other, and a caption below them."""
    return f"<figure>{content}<figcaption>{escape(caption)}</figcaption></figure>"


def headings(names: Sequence[str]) -> str:
    """Headings over a picture of as many columns, equally wide; nothing if there are none."""
    cells = "".join(f"<span>{escape(name)}</span>" for name in names)
    return f'<div class="headings">{cells}</div>' if names else ""


def grid(figures: Sequence[str]) -> str:
    """Figures side by side, as many as fit into a row; nothing if there is none."""
    return f'<div class="grid">{"".join(figures)}</div>' if figures else ""
