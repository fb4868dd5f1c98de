"""Pieces of an HTML page that needs no other file: text, tables, pictures."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from PIL import Image

_LONGEST_SIDE = 1560
"""Pixels; larger pictures are reduced, so that a page can be sent by mail."""
_QUALITY = 85
_STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: .3rem; } h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .8rem .2rem 0; border-bottom: 1px solid #8884; text-align: left;
  vertical-align: top; }
.scores td:not(:first-child), .scores th:not(:first-child) { text-align: right; padding-left: 1rem; }
.scores tr.mean { font-weight: 650; }
.facts { margin-bottom: 1rem; }
.facts th { font-weight: 400; opacity: .7; white-space: nowrap; }
.facts td { overflow-wrap: anywhere; }
.grid { display: grid; grid-template-columns: repeat(auto-fill, minmax(21rem, 1fr)); gap: 1.4rem; }
figure { margin: 0 0 1.2rem; } figcaption { font-size: .9rem; padding-bottom: .25rem; }
img { max-width: 100%; height: auto; display: block; }
svg { width: 100%; height: auto; } svg text { fill: currentColor; font-size: 11px; opacity: .75; }
svg .rule { stroke: #8883; } svg polyline { fill: none; stroke-width: 1.6; stroke-linejoin: round; }
.plot ul { list-style: none; margin: .2rem 0 0; padding: 0; font-size: .85rem; }
.plot li { display: inline-block; margin-right: 1rem; }
.plot li span { display: inline-block; width: .8em; height: .8em; margin-right: .4em; }
pre { background: #8881; padding: .8rem 1rem; overflow-x: auto; font-size: .85rem; }
.note { font-size: .9rem; opacity: .8; }
"""


def page(title: str, parts: Iterable[str]) -> str:
    """A whole document of parts that are HTML already."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body></html>\n"
    )


def section(title: str, content: str) -> str:
    """A heading and what follows; nothing if nothing follows."""
    return f"<h2>{escape(title)}</h2>\n{content}" if content else ""


def facts_table(facts: Mapping[str, Any]) -> str:
    """Names and values, in two columns; nested mappings become `outer.inner`."""
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(_plain(value))}</td></tr>"
        for name, value in _flat(facts)
    )
    return f'<div class="scroll"><table class="facts">{rows}</table></div>' if rows else ""


def _plain(value: Any) -> str:
    """A value of JSON as a person writes it."""
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "\u2013"}[value]
    if isinstance(value, int):
        return f"{value:,}" if abs(value) >= 10_000 else str(value)
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 10_000 else f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(_plain(child) for child in value)
    return str(value)


def score_table(head: Sequence[str], rows: Sequence[tuple[Sequence[str], bool]]) -> str:
    """Texts in columns, of which the first is a name.

    Args:
        rows: cells, and whether they are a mean.
    """
    body = "".join(
        f"<tr{' class=mean' if mean else ''}>{_cells('td', cells)}</tr>" for cells, mean in rows
    )
    table = f"<thead><tr>{_cells('th', head)}</tr></thead><tbody>{body}</tbody>"
    return f'<div class="scroll"><table class="scores">{table}</table></div>'


def picture(path: Path, caption: str) -> str:
    """An image file, as JPEG inside the page."""
    buffer = io.BytesIO()
    with Image.open(path) as image:
        image.thumbnail((_LONGEST_SIDE, _LONGEST_SIDE))
        image.convert("RGB").save(buffer, "JPEG", quality=_QUALITY)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return (
        f"<figure><figcaption>{escape(caption)}</figcaption>"
        f'<img alt="{escape(caption)}" src="data:image/jpeg;base64,{data}"></figure>'
    )


def _cells(tag: str, texts: Iterable[str]) -> str:
    return "".join(f"<{tag}>{escape(text)}</{tag}>" for text in texts)


def _flat(facts: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, Any]]:
    for name, value in facts.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
