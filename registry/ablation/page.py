"""The ablation as one HTML page that needs no other file: tables, plots, renders and depths."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path

from PIL import Image

from ..results import RENDERS
from . import table
from .folder import AblationFolder
from .plan import Plan
from .plots import plots
from .scores import Results

_STYLE = """
:root { color-scheme: light dark; --line: #8884; --soft: #8881; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1200px; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2.2rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding: .8rem 0 .3rem; }
th, td { padding: .25rem .7rem; border-bottom: 1px solid var(--line); text-align: right; }
th.chosen, td.chosen { text-align: center; }
td.best { font-weight: 700; }
.plots, .views { display: flex; flex-wrap: wrap; align-items: flex-start; gap: 1.2rem; }
figure { margin: 0; } figcaption { font-size: .85rem; padding: .25rem 0; }
.plot { flex: 1 1 420px; max-width: 560px; } .plot figcaption { font-weight: 600; }
.plot ul { list-style: none; padding: 0; margin: .3rem 0; font-size: .85rem; }
.plot li span { display: inline-block; width: .8em; height: .8em; margin-right: .5em; }
svg text { fill: currentColor; font-size: 11px; } svg .grid { stroke: var(--line); }
.view { flex: 0 1 270px; background: var(--soft); padding: .5rem; }
.view img { display: block; width: 100%; margin-bottom: 2px; }
"""
_LONGEST_SIDE = 640
_QUALITY = 88


def as_page(plan: Plan, results: Results, folder: AblationFolder) -> str:
    """The whole page. Pictures are of the first seed and each scene's first test view."""
    drawn = "".join(plots(plan, results))
    parts = [
        f"<h1>Ablation: {escape(plan.name)}</h1>",
        f"<p>{plan.size}. Bold: the best of a column.</p>",
        *(_table(plan, results, title, scene) for title, scene in table.titles(plan)),
        *(f"<p>{escape(line)}</p>" for line in table.notes(plan, results)),
        f'<h2>Plots</h2><div class="plots">{drawn}</div>' if drawn else "",
    ]
    for scene in plan.scenes:
        parts += _pictures(plan, results, folder, scene)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(plan.name)}</title><style>{_STYLE}</style></head>\n<body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body></html>\n"
    )


def _table(plan: Plan, results: Results, caption: str, scene: str | None) -> str:
    chosen, measured = table.headings(plan, results)
    head = "".join(f'<th class="chosen">{escape(name)}</th>' for name in chosen)
    head += "".join(f"<th>{escape(name)}</th>" for name in measured)
    lines = []
    for row in table.rows(plan, results, scene):
        cells = [f'<td class="chosen">{escape(t)}</td>' for t in (*row.toggles, *row.values)]
        for text, best in zip(row.numbers, row.best, strict=True):
            kind = "best" if best else "number"
            cells.append(f'<td class="{kind}">{escape(text)}</td>')
        if row.progress:
            cells.append(f"<td>{escape(row.progress)} runs</td>")
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return (
        f'<div class="wide"><table><caption>{escape(caption)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"
    )


def _pictures(plan: Plan, results: Results, folder: AblationFolder, scene: str) -> Iterator[str]:
    """The photograph of the first test view, then each combination's render and depth of it."""
    figures: list[str] = []
    for run, found in results.items():
        views = found.get("scene", {}).get("test", []) if found else []
        if run.scene != scene or run.seed != plan.seeds[0] or not views:
            continue
        renders = folder.run(run).path / RENDERS
        name = str(views[0]).removesuffix(".png")
        files = [renders / f"{name}.png", renders / f"{name}_depth.png"]
        comparison = renders / f"{name}_comparison.png"
        if not all(file.is_file() for file in (*files, comparison)):
            continue
        if not figures:
            figures.append(_view(f"{views[0]}: photograph", _photograph(comparison, files[0])))
        caption = [plan.describe(run.combination), *_scores(found["views"]["test"][views[0]])]
        images = _file(files[0], "render") + _file(files[1], "depth")
        figures.append(_view(", ".join(caption), images))
    if figures:
        yield f'<h2>{escape(scene)}</h2><div class="views">{"".join(figures)}</div>'


def _scores(view: Mapping[str, float | None]) -> list[str]:
    return [f"{name} {score:.4g}" for name, score in view.items() if score is not None]


def _photograph(comparison: Path, render: Path) -> str:
    """Cut out of truth, render, depth side by side; the run keeps it nowhere else."""
    with Image.open(render) as one, Image.open(comparison) as picture:
        return _image(picture.crop((0, 0, *one.size)), "photograph")


def _view(caption: str, images: str) -> str:
    return f'<figure class="view">{images}<figcaption>{escape(caption)}</figcaption></figure>'


def _file(path: Path, alt: str) -> str:
    with Image.open(path) as picture:
        return _image(picture, alt)


def _image(image: Image.Image, alt: str) -> str:
    """An <img> with the picture inside."""
    picture = image.convert("RGB")
    picture.thumbnail((_LONGEST_SIDE, _LONGEST_SIDE))
    data = io.BytesIO()
    picture.save(data, format="JPEG", quality=_QUALITY)
    encoded = base64.b64encode(data.getvalue()).decode("ascii")
    return f'<img alt="{alt}" src="data:image/jpeg;base64,{encoded}">'
