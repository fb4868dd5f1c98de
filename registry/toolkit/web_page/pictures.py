"""Images in a page: embedded, in grids, compared with a slider or a menu."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL import Image

LONGEST_SIDE = 1560
"""Pixels; larger images are downsampled, so that a page is small enough for e-mail."""
_QUALITY = 85
_WIPE = "this.parentNode.style.setProperty('--cut', this.value + '%')"
_SHOW = (
    "[...this.closest('.choice').querySelectorAll(':scope > div')].forEach("
    "(part, index) => part.hidden = index !== this.selectedIndex)"
)


def image(source: Path | Image.Image, alt: str, longest_side: int = LONGEST_SIDE) -> str:
    """Embed an image as JPEG, downsampled to at most `longest_side` pixels per side."""
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
    """Return images in a column with a caption below."""
    return f"<figure>{content}<figcaption>{escape(caption)}</figcaption></figure>"


def headings(names: Sequence[str]) -> str:
    """Return headings for the equally wide columns of an image; empty for no names."""
    cells = "".join(f"<span>{escape(name)}</span>" for name in names)
    return f'<div class="headings">{cells}</div>' if names else ""


def grid(figures: Sequence[str]) -> str:
    """Return figures side by side, as many per row as fit; empty for no figures."""
    return f'<div class="grid">{"".join(figures)}</div>' if figures else ""


def wipe(left: str, right: str, labels: tuple[str, str]) -> str:
    """Return two images of equal size on top of each other, with a slider for the border between them.

    Args:
        left, right: HTML of an image each.
        labels: Labels of the images, shown in the corners.
    """
    corners = "".join(f"<span>{escape(label)}</span>" for label in labels)
    return (
        f'<div class="wipe">{right}<div class="over">{left}</div>'
        f'<div class="corners">{corners}</div>'
        f'<input type="range" min="0" max="100" value="50" step="0.5" '
        f'aria-label="{escape(" or ".join(labels))}" oninput="{escape(_WIPE)}"></div>'
    )


def pinned(first: str, others: Sequence[str]) -> str:
    """Return a figure that stays visible next to a grid of other figures."""
    return f'<div class="pinned"><div>{first}</div><div class="grid">{"".join(others)}</div></div>'


def choice(label: str, parts: Mapping[str, str]) -> str:
    """Return parts with a menu that shows one by name, initially the first; a single part has no menu."""
    if len(parts) < 2:
        return "".join(parts.values())
    options = "".join(f"<option>{escape(name)}</option>" for name in parts)
    shown = "".join(
        f"<div{' hidden' if index else ''}>{part}</div>"
        for index, part in enumerate(parts.values())
    )
    return (
        f'<div class="choice"><label>{escape(label)} '
        f'<select autocomplete="off" onchange="{escape(_SHOW)}">{options}</select></label>{shown}</div>'
    )


def color_scale(colors: Sequence[tuple[float, float, float]], ticks: Sequence[str]) -> str:
    """Return a bar of evenly spaced colors, each in [0, 1], with evenly spaced texts below."""
    stops = ", ".join(
        f"rgb({', '.join(str(round(255 * part)) for part in color)})" for color in colors
    )
    texts = "".join(f"<span>{escape(tick)}</span>" for tick in ticks)
    return (
        f'<div class="scale"><i style="background:linear-gradient(to right, {stops})"></i>'
        f"<div>{texts}</div></div>"
    )
