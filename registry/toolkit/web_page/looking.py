"""Ways to look at pictures: one wiped over another, one pinned beside many, one choice shown of several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

_WIPE = "this.parentNode.style.setProperty('--cut', this.value + '%')"
_SHOW = (
    "[...this.closest('.choice').querySelectorAll(':scope > div')].forEach("
    "(part, index) => part.hidden = index !== this.selectedIndex)"
)


def wipe(left: str, right: str, labels: tuple[str, str]) -> str:
    """Two pictures of one size, one upon the other, and a handle that moves the border between them.

    Args:
        left, right: HTML of an image each.
        labels: what each of them is, for the corners.
    """
    corners = "".join(f"<span>{escape(label)}</span>" for label in labels)
    return (
        f'<div class="wipe">{right}<div class="over">{left}</div>'
        f'<div class="corners">{corners}</div>'
        f'<input type="range" min="0" max="100" value="50" step="0.5" '
        f'aria-label="{escape(" or ".join(labels))}" oninput="{escape(_WIPE)}"></div>'
    )


def pinned(first: str, others: Sequence[str]) -> str:
    """A figure that stays in sight while one looks through others beside it."""
    return f'<div class="pinned"><div>{first}</div><div class="grid">{"".join(others)}</div></div>'


def choice(label: str, parts: Mapping[str, str]) -> str:
    """One of several parts, chosen by name; the first at first, alone without a choice."""
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
    """A bar of colours, evenly spaced, each in [0, 1], with texts evenly spaced below."""
    stops = ", ".join(
        f"rgb({', '.join(str(round(255 * part)) for part in color)})" for color in colors
    )
    texts = "".join(f"<span>{escape(tick)}</span>" for tick in ticks)
    return (
        f'<div class="scale"><i style="background:linear-gradient(to right, {stops})"></i>'
        f"<div>{texts}</div></div>"
    )
