"""What `benchmarks.error` found, as tables on the terminal and as a page with a picture in `docs/`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

WIDTH = 130
"""Characters of the widest table; a narrower terminal wraps or scrolls."""
DOCS = Path(__file__).parent.parent / "docs"
PAGE = DOCS / "speed_and_error.md"
PICTURE = DOCS / "images" / "speed_and_error.png"

COLUMNS = (
    "switch",
    "setting",
    "forward ms",
    "backward ms",
    "time",
    "image max",
    "image 99.9 %",
    "image dB",
    "gradient",
    "to truth dB",
)
ADAM_COLUMNS = (
    "Adam",
    "step ms",
    "iteration",
    "fit dB",
    "movement",
    "image max",
    "image 99.9 %",
)
SCENES = {
    "surfaces": "flat discs on wavy walls, generated",
    "garden": "points of a photographed garden (Mip-NeRF 360) with sizes from three neighbours, opacity "
    "0.8, random shapes, and noise for the SH bands that points do not have",
}
INTRODUCTION = """\
# Run time against error

The engine leaves things out to be fast. Here each of them is switched alone, and what it saves stands
beside what it gets wrong. `make bench-error` measures it all anew and rewrites this page.

![Time ratio against image error, a point a setting](images/speed_and_error.png)

## How to read it

- **Bold** is how the engine is built. *time* is forward and backward pass together over those of the bold
  setting: above 1 a setting is slower. The two take turns, and the ratio is the median over the turns;
  milliseconds are the default's median times a ratio, so that what else the machine does cancels. Races of
  the default against a second build of itself gave {low:.2f} to {high:.2f}; a few hundredths mean little.
- *image max* is the largest error of a colour, *image 99.9 %* the error that one value in a thousand
  exceeds, both over the largest colour; *image dB* is PSNR with white at 1. *gradient* is
  |error| / |gradient| of the parameter that fares worst, for one fixed random weighting of the image.
- Errors of the alpha cut-off, the early stop, the exponential, the number type and the SH degree are
  measured from double-precision kernels in which **this one switch** is at its most exact and all others
  are as they are. Errors of the tile size, the exact tile test, the depth gradient and the raster kernels
  are measured from the default: they should change nothing but the order of additions.
- *to truth dB* compares with double precision and nothing left out at all: cut-off 1e-6, no early stop. The
  cut-off dominates it. 1/255 is a convention that published scenes were trained with, so it is part of
  what this engine promises, but it is the one choice whose error could be seen.
- Where a Gaussian is within rounding of a threshold, float and double decide differently. A few pixels then
  differ by up to 1/255 of a colour, which shows in *image max* and not in *image 99.9 %*.
- *SH degree* renders stored degree 3 with fewer bands. Skipped bands have no gradient: hence its error.
- *Adam, visible only* leaves values alone whose gradient is exactly zero, as it is for everything unseen.
  *movement* is how far it ends from where Adam goes, over how far Adam goes, after {steps} steps over all
  views of the scene from disturbed colours; *fit dB* is the PSNR then reached in the first view, *iteration*
  the time of a whole one over that with Adam.

Measured on {device}.
"""


def print_tables(result: dict[str, Any]) -> None:
    """The figures as tables on the terminal."""
    console = Console()
    console.width = max(console.width, WIDTH)
    console.print(f"[bold]{result['device']}[/]")
    for name, scene in result["scenes"].items():
        console.print(f"\n[bold]{name}[/]: {_headline(name, scene)}")
        for columns, rows in ((COLUMNS, _rows(scene)), (ADAM_COLUMNS, _adam_rows(scene))):
            table = Table(*columns, box=SIMPLE)
            for default, cells in rows:
                table.add_row(*cells, style="bold" if default else "")
            console.print(table)


def write_docs(result: dict[str, Any]) -> tuple[Path, Path]:
    """Write the page and its picture, which shows the last scene; return both paths."""
    from benchmarks.error_picture import draw  # the tables do without matplotlib

    scenes = result["scenes"]
    steps = next(iter(scenes.values()))["sparse_adam"]["steps"]
    itself = [ratio for scene in scenes.values() for ratio in scene["ratios_to_itself"]]
    parts = [
        INTRODUCTION.format(low=min(itself), high=max(itself), steps=steps, device=result["device"])
    ]
    for name, scene in scenes.items():
        parts.append(f"## {name.capitalize()}\n\n{_headline(name, scene)}\n")
        parts.append(_markdown(COLUMNS, _rows(scene)))
        parts.append(_markdown(ADAM_COLUMNS, _adam_rows(scene)))
    PAGE.write_text("\n".join(parts), encoding="utf-8")
    name, scene = list(scenes.items())[-1]
    draw(scene, f"{name}, {scene['gaussians']:,} Gaussians, {result['device']}", PICTURE)
    return PAGE, PICTURE


def _headline(name: str, scene: dict[str, Any]) -> str:
    width, height = scene["size"]
    return f"{scene['gaussians']:,} Gaussians in {width}x{height} pixels; {SCENES[name]}."


def _rows(scene: dict[str, Any]) -> list[tuple[bool, list[str]]]:
    """Cells of each setting, and whether it is the default; a switch is named once."""
    names = [row["switch"] for row in scene["rows"]]
    return [
        (
            row["default"],
            [
                name if name != before else "",
                row["setting"],
                f"{row['forward_ratio'] * scene['default_forward_ms']:.1f}",
                f"{row['backward_ratio'] * scene['default_backward_ms']:.1f}",
                f"{row['time_ratio']:.2f}",
                _small(row["image_max"]),
                _small(row["image_999"]),
                _decibel(row["image_psnr"]),
                _small(row["gradient"]),
                _decibel(row["total_psnr"]),
            ],
        )
        for name, before, row in zip(names, ["", *names], scene["rows"], strict=False)
    ]


def _adam_rows(scene: dict[str, Any]) -> list[tuple[bool, list[str]]]:
    adam = scene["sparse_adam"]
    dense = ["all", f"{adam['dense_ms']:.2f}", "1.00", _decibel(adam["dense_psnr"]), "0", "0", "0"]
    sparse = [
        "visible only",
        f"{adam['sparse_ms']:.2f}",
        f"{adam['time_ratio']:.2f}",
        _decibel(adam["sparse_psnr"]),
        *(_small(adam[name]) for name in ("movement", "image_max", "image_999")),
    ]
    return [(True, dense), (False, sparse)]


def _small(error: float) -> str:
    return f"{error:.1e}" if error else "0"


def _decibel(value: float) -> str:
    return "equal" if value == float("inf") else f"{value:.1f}"


def _markdown(columns: tuple[str, ...], rows: list[tuple[bool, list[str]]]) -> str:
    lines = [" | ".join(columns), " | ".join(["---"] * len(columns))]
    lines += [
        " | ".join(
            f"**{cell}**" if default and cell and number else cell
            for number, cell in enumerate(cells)
        )
        for default, cells in rows
    ]
    return "".join(f"| {line} |\n" for line in lines)
