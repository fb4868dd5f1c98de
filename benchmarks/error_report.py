"""Results of `benchmarks.error` as tables, and a picture in `docs`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks import pages
from stereogs.experiments.showing.score_table import markdown

TARGET = "bench-error"
PICTURE = pages.DOCS / "images" / "engine_error.png"

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
SCENES = {
    "surfaces": "flat discs on wavy walls, generated",
    "garden": "points of a photographed garden (Mip-NeRF 360) with sizes from three neighbours, opacity "
    "0.8, random shapes, and noise for the SH bands that points do not have",
}
INTRODUCTION = """\
Each approximation of the engine is switched alone; its time and its error are compared with the default.

- **Bold** is the default. *time* is forward and backward pass together over those of the default. Default and
  variant take turns; the ratio is the median over the turns. Milliseconds are the default's median times a
  ratio: the load of other processes cancels. Ratios of the default to a second build of itself:
  {low:.2f} to {high:.2f}.
- *image max* is the largest error of a colour, *image 99.9 %* the 99.9th percentile, both over the largest
  colour; *image dB* is PSNR with white at 1. *gradient* is |error| / |gradient| of the parameter with the
  largest ratio, for one fixed random weighting of the image.
- Errors of the alpha cut-off, early stop, exponential, number type and SH degree are
  relative to double-precision kernels in which this one switch is at its most exact setting and all others
  are at their defaults. Errors of the tile size, the exact tile test, the depth gradient and the raster
  kernels are relative to the default: only the order of additions should change.
- *to truth dB* compares with double precision, a cut-off of 1e-6 and no early stop. The cut-off dominates
  it; published scenes were trained with 1/255.
- If a Gaussian is within rounding of a threshold, float and double decide differently. A few pixels then
  differ by up to 1/255 of a colour, visible in *image max* but not in *image 99.9 %*.
- *SH degree* renders stored degree 3 with fewer bands. Skipped bands have no gradient, hence its error.

Measured on {device}.
"""


def tables(result: dict[str, Any]) -> str:
    """Return all tables, with notes, in Markdown."""
    scenes = result["scenes"]
    itself = [ratio for scene in scenes.values() for ratio in scene["ratios_to_itself"]]
    parts = [INTRODUCTION.format(low=min(itself), high=max(itself), device=result["device"])]
    for name, scene in scenes.items():
        parts.append(f"## {name.capitalize()}\n\n{_headline(name, scene)}\n")
        parts.append(_markdown(COLUMNS, _rows(scene)))
    return "\n".join(parts)


def write_docs(result: dict[str, Any]) -> tuple[Path, ...]:
    """Write the tables and the picture, which shows the last scene; return their paths."""
    from benchmarks.error_picture import draw  # the tables do without matplotlib

    scenes = result["scenes"]
    file = pages.write_tables("error", "Run time against error", TARGET, tables(result))
    name, scene = list(scenes.items())[-1]
    draw(scene, f"{name}, {scene['gaussians']:,} Gaussians, {result['device']}", PICTURE)
    return file, PICTURE


def _headline(name: str, scene: dict[str, Any]) -> str:
    width, height = scene["size"]
    return f"{scene['gaussians']:,} Gaussians in {width}x{height} pixels; {SCENES[name]}."


def _rows(scene: dict[str, Any]) -> list[tuple[bool, list[str]]]:
    """Cells of each setting, and whether it is the default; only the first row names the switch."""
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


def _small(error: float) -> str:
    return f"{error:.1e}" if error else "0"


def _decibel(value: float) -> str:
    return "equal" if value == float("inf") else f"{value:.1f}"


def _markdown(columns: tuple[str, ...], rows: list[tuple[bool, list[str]]]) -> str:
    marked = [
        [
            f"**{cell}**" if default and cell and number else cell
            for number, cell in enumerate(cells)
        ]
        for default, cells in rows
    ]
    return markdown(columns, marked, names=len(columns))
