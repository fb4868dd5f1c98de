"""The document and its parts: style, sections, text, tables, images."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

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


def page(title: str, contents: Iterable[str]) -> str:
    """Return an HTML document; empty contents are skipped."""
    style = Path(__file__).with_name("style.css").read_text("utf-8")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>\n{style}</style></head><body>\n"
        f"<h1>{escape(title)}</h1>\n"
        + "\n".join(content for content in contents if content)
        + "\n</body></html>\n"
    )


def section(title: str, content: str) -> str:
    """Return a heading with its content; empty for empty content."""
    return f"<h2>{escape(title)}</h2>\n{content}" if content else ""


def subsection(title: str, content: str) -> str:
    """Return a smaller heading with its content; empty for empty content."""
    return f"<h3>{escape(title)}</h3>\n{content}" if content else ""


def folded(title: str, content: str) -> str:
    """Return content that unfolds when its title is clicked; empty for empty content."""
    return f"<details><summary>{escape(title)}</summary>{content}</details>" if content else ""


def note(text: str) -> str:
    """Return a paragraph in small print."""
    return f'<p class="note">{escape(text)}</p>'


def verbatim(text: str) -> str:
    """Return preformatted text; empty for an empty text."""
    return f"<pre>{escape(text)}</pre>" if text else ""


@dataclass(frozen=True)
class Cell:
    """A cell of a table of scores: plain text, bold if `strong`."""

    text: str
    strong: bool = False


def facts_table(facts: Mapping[str, Any]) -> str:
    """Return a table of names and JSON values; nested mappings become `outer.inner`."""
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(_plain(value))}</td></tr>"
        for name, value in _flat(facts)
    )
    return f'<div class="scroll"><table class="facts">{rows}</table></div>' if rows else ""


def score_table(
    head: Sequence[str], rows: Sequence[Sequence[Cell]], *, names: int = 1, caption: str = ""
) -> str:
    """Return a table of numbers.

    Args:
        head, rows: Header of each column, and rows of the same length.
        names: Number of columns on the left that hold names, not numbers.
        caption: Text above the table; may be empty.
    """
    titles = _cells("th", [Cell(text) for text in head], names)
    body = "".join(f"<tr>{_cells('td', row, names)}</tr>" for row in rows)
    above = f"<caption>{escape(caption)}</caption>" if caption else ""
    table = f"{above}<thead><tr>{titles}</tr></thead><tbody>{body}</tbody>"
    return f'<div class="scroll"><table class="scores">{table}</table></div>'


def _cells(tag: str, cells: Sequence[Cell], names: int) -> str:
    parts = []
    for column, cell in enumerate(cells):
        kinds = ["name"] * (column < names) + ["strong"] * cell.strong
        attribute = f' class="{" ".join(kinds)}"' if kinds else ""
        parts.append(f"<{tag}{attribute}>{escape(cell.text)}</{tag}>")
    return "".join(parts)


def _plain(value: Any) -> str:
    """Format a JSON value."""
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "\u2013"}[value]
    if isinstance(value, int):
        return f"{value:,}" if abs(value) >= 10_000 else str(value)
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 10_000 else f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(_plain(child) for child in value)
    return str(value)


def _flat(facts: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, Any]]:
    for name, value in facts.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


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
    """Return two images of equal size, one over the other, with labels and a slider for their border."""
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
