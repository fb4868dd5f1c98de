"""Web pages that need no other file: for reports, and for whatever else is shown to people.

    from registry import web_page

    text = web_page.page("Title", [web_page.section("Scores", web_page.score_table(head, rows))])

A page has no script and loads nothing, so that it can be mailed. All functions take plain text, escape it
and return HTML; only what is called *content* is HTML already.
"""

from .document import note, page, section, verbatim
from .line_plot import Axis, Line, Point, line_plot
from .pictures import figure, grid, image
from .tables import Cell, facts_table, score_table

__all__ = [
    "Axis",
    "Cell",
    "Line",
    "Point",
    "facts_table",
    "figure",
    "grid",
    "image",
    "line_plot",
    "note",
    "page",
    "score_table",
    "section",
    "verbatim",
]
