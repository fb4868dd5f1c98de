"""Web pages that need no other file: for reports, and for whatever else is shown to people.

    from registry import web_page

    text = web_page.page("Title", [web_page.section("Scores", web_page.score_table(head, rows))])

A page loads nothing, so that it can be mailed; all that moves in it is told in its own elements. All
functions take plain text, escape it and return HTML; only what is called *content* is HTML already.
"""

from .document import folded, note, page, section, subsection, verbatim
from .line_plot import Axis, Line, Point, line_plot
from .looking import choice, color_scale, pinned, wipe
from .pictures import figure, grid, headings, image
from .tables import Cell, facts_table, score_table

__all__ = [
    "Axis",
    "Cell",
    "Line",
    "Point",
    "choice",
    "color_scale",
    "facts_table",
    "figure",
    "folded",
    "grid",
    "headings",
    "image",
    "line_plot",
    "note",
    "page",
    "pinned",
    "score_table",
    "section",
    "subsection",
    "verbatim",
    "wipe",
]
