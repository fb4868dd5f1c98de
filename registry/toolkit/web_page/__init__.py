"""Self-contained web pages: text, tables, images, line plots.

    from registry.toolkit import web_page

    table = web_page.score_table(["method", "PSNR"], [[Cell("ours"), Cell("21.4", strong=True)]])
    text = web_page.page("Title", [web_page.section("Scores", table)])

A page loads no other file, so it can be sent by e-mail. Functions return HTML and escape their arguments,
except page contents, figures and images that other functions returned.
"""

from .document import (
    Cell,
    choice,
    color_scale,
    facts_table,
    figure,
    folded,
    grid,
    headings,
    image,
    note,
    page,
    pinned,
    score_table,
    section,
    subsection,
    verbatim,
    wipe,
)
from .line_plot import Axis, Line, Point, line_plot

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
