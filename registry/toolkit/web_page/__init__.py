"""Self-contained web pages: text, tables, images, line plots.

    from registry.toolkit import web_page

    table = web_page.score_table(["method", "PSNR"], [[Cell("ours"), Cell("21.4", strong=True)]])
    text = web_page.page("Title", [web_page.section("Scores", table)])

A page loads no other file, so it can be sent by e-mail. Functions return HTML and escape their arguments,
except page contents, figures and images that other functions returned.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .document import (
        Cell as Cell,
        choice as choice,
        color_scale as color_scale,
        facts_table as facts_table,
        figure as figure,
        folded as folded,
        grid as grid,
        headings as headings,
        image as image,
        note as note,
        page as page,
        score_table as score_table,
        section as section,
        subsection as subsection,
        verbatim as verbatim,
        wipe as wipe,
    )
    from .svg_plot import Axis as Axis, Line as Line, Point as Point, line_plot as line_plot
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
