"""The document: style, title, sections and text."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

_STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: .3rem; } h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem; }
.scroll { overflow-x: auto; --shade: linear-gradient(to right, #8887, #8880);
  --cover: linear-gradient(to right, Canvas 50%, transparent);
  --shade-right: linear-gradient(to left, #8887, #8880);
  --cover-right: linear-gradient(to left, Canvas 50%, transparent);
  background: var(--cover) left / 2rem 100% no-repeat local,
    var(--cover-right) right / 2rem 100% no-repeat local,
    var(--shade) left / .8rem 100% no-repeat, var(--shade-right) right / .8rem 100% no-repeat; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding: .8rem 0 .3rem; }
th, td { padding: .2rem .8rem .2rem 0; border-bottom: 1px solid #8884; text-align: left;
  vertical-align: top; }
.scores th, .scores td { text-align: right; padding: .2rem .8rem; }
.scores .name { text-align: left; padding-left: 0; } .scores .strong { font-weight: 650; }
.facts { margin-bottom: 1rem; }
.facts th { font-weight: 400; opacity: .7; white-space: nowrap; }
.facts td { overflow-wrap: anywhere; }
.grid { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(21rem, 100%), 1fr)); gap: 1.4rem; }
figure { margin: 0 0 1.2rem; } figcaption { font-size: .9rem; padding: .25rem 0; }
img { max-width: 100%; height: auto; display: block; } .grid img { width: 100%; margin-bottom: 2px; }
.headings { display: grid; grid-auto-flow: column; grid-auto-columns: minmax(0, 1fr); gap: .3rem;
  font-size: .8rem; max-width: 1560px; overflow-wrap: anywhere; align-items: end; }
.plot figcaption { font-weight: 600; }
svg { width: 100%; height: auto; overflow: visible; }
svg text { fill: currentColor; font-size: 11px; opacity: .75; } svg .rule { stroke: #8883; }
svg polyline { fill: none; stroke-width: 1.6; stroke-linejoin: round; }
svg .mark { fill: none; stroke-width: 1.2; }
.plot ul { list-style: none; margin: .2rem 0 0; padding: 0; font-size: .85rem; }
.plot li { display: inline-block; margin-right: 1rem; }
.plot li span { display: inline-block; width: .8em; height: .8em; margin-right: .4em; }
pre { background: #8881; padding: .8rem 1rem; overflow-x: auto; font-size: .85rem; }
.note { font-size: .9rem; opacity: .8; }
.wipe { position: relative; max-width: 48rem; --cut: 50%; } .wipe img { width: 100%; }
.wipe .over { position: absolute; inset: 0 0 auto; clip-path: inset(0 calc(100% - var(--cut)) 0 0); }
.wipe input { width: 100%; margin: .4rem 0 0; }
.corners { position: absolute; inset: .4rem .4rem auto; display: flex; justify-content: space-between; }
.corners span { background: #000a; color: #fff; font-size: .8rem; padding: 0 .4rem; }
.pinned { display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 3fr); gap: 1.4rem; }
.pinned > :first-child { position: sticky; top: .5rem; align-self: start; }
.pinned > :first-child img { width: 100%; }
.pinned .grid { grid-template-columns: repeat(auto-fill, minmax(min(17rem, 100%), 1fr)); }
.choice select, .scene-view select { font: inherit; max-width: 100%; margin-bottom: .6rem; }
.scale { font-size: .8rem; padding-top: .3rem; } .scale i { display: block; height: .7rem; }
.scale div { display: flex; justify-content: space-between; }
.canvas { position: relative; max-width: 100%; background: #8882; margin-bottom: .5rem; }
.canvas canvas { position: absolute; inset: 0; touch-action: none; }
details { margin-bottom: 1rem; } summary { cursor: pointer; }
h3 { font-size: 1rem; margin: 1.4rem 0 .5rem; }
@media (max-width: 45rem) {
  body { margin: 1rem auto; } .facts th { white-space: normal; }
  .scores { font-size: .87rem; } .scores th, .scores td { padding: .2rem .4rem; }
  .pinned { grid-template-columns: minmax(0, 1fr); }
  .pinned > :first-child { z-index: 1; background: Canvas; padding-bottom: .3rem; }
  .pinned > :first-child img { max-height: 30vh; width: auto; }
}
"""


def page(title: str, contents: Iterable[str]) -> str:
    """Return an HTML document; empty contents are skipped."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>\n"
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
