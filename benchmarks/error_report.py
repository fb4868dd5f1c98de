"""What `benchmarks.error` found, as tables on the terminal and as a page with a picture in `docs/`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.error_picture import draw

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
    "garden": "points of a photographed garden (Mip-NeRF 360), their size from three neighbours, opacity 0.8",
}
INTRODUCTION = """\
# Run time against error

The engine leaves things out to be fast. Here each of them is switched alone, and what it saves stands beside
what it gets wrong. `make bench-error` measures it all anew and rewrites this page.

![Time ratio against image error, a point a setting](images/speed_and_error.png)

## How to read it

- **Bold** is how the engine is built. *time* is forward and backward pass together over the bold setting's: above 1
  the setting is slower. The two take turns and the ratio is the median of the turns; milliseconds are the
  default's median times a ratio, so that the load of a shared machine cancels. The default raced against a second
  build of itself gave {itself}: smaller differences than that mean nothing.
- *image max* and *image 99.9 %* are the largest error of a colour and the error that one value in a thousand exceeds,
  both over the largest colour; *dB* is PSNR with white at 1. *gradient* is |error| / |gradient| of the parameter that
  fares worst, for one fixed random weighting of the image.
- Errors of the alpha cut-off, the early stop, the exponential, the number type and the SH degree are those against
  double-precision kernels in which **this one switch** is at its most exact and all others are as they are. Errors of
  the tile size, the exact tile test, the depth gradient and the kernels are those against the default: they should
  change nothing but the order of additions.
- *to truth* compares with double precision and nothing left out at all (cut-off 1e-6, no early stop). The cut-off
  dominates it. That 1/255 is a convention which trained scenes have grown up with, more than an approximation.
- Where a Gaussian is within rounding of a threshold, float and double decide differently; single pixels then differ by
  up to 1/255 of a colour, which shows in *image max* and not in *image 99.9 %*.
- *SH degree* renders stored degree 3 with fewer bands. Bands that are skipped have no gradient, hence the errors there.
- *Adam, visible only* leaves parameters alone whose gradient is exactly zero. *movement* is how far it ends from where
  Adam goes, over how far Adam goes, after {steps} steps over all views of the scene from disturbed colours; *fit* is
  the PSNR then reached in the first view, *iteration* the time of a whole one over Adam's.

Measured on {device}.
"""


def print_tables(result: dict[str, Any]) -> None:
    """The figures as tables on the terminal."""
    console = Console()
    console.print(f"[bold]{result['device']}[/]")
    for name, scene in result["scenes"].items():
        console.print(f"\n[bold]{name}[/]: {_headline(name, scene)}")
        for columns, rows in ((COLUMNS, _rows(scene)), (ADAM_COLUMNS, _adam_rows(scene))):
            table = Table(*columns)
            for default, cells in rows:
                table.add_row(*cells, style="bold" if default else "")
            console.print(table)


def write_docs(result: dict[str, Any]) -> tuple[Path, Path]:
    """Write the page and its picture, which shows the last scene; return both paths."""
    scenes = result["scenes"]
    steps = next(iter(scenes.values()))["sparse_adam"]["steps"]
    itself = " and ".join(f"{scene['ratio_to_itself']:.2f}" for scene in scenes.values())
    parts = [INTRODUCTION.format(itself=itself, steps=steps, device=result["device"])]
    for name, scene in scenes.items():
        parts.append(f"## {name.capitalize()}\n\n{_headline(name, scene)}\n")
        parts.append(_markdown(COLUMNS, _rows(scene)))
        parts.append(_markdown(ADAM_COLUMNS, _adam_rows(scene)))
    PAGE.write_text("\n".join(parts), encoding="utf-8")
    name, scene = list(scenes.items())[-1]
    draw(scene, f"{name}: {_headline(name, scene)}", PICTURE)
    return PAGE, PICTURE


def _headline(name: str, scene: dict[str, Any]) -> str:
    width, height = scene["size"]
    return f"{scene['gaussians']:,} Gaussians in {width}x{height} pixels; {SCENES[name]}."


def _rows(scene: dict[str, Any]) -> list[tuple[bool, list[str]]]:
    """Cells of each setting, and whether it is the default."""
    return [
        (
            row["default"],
            [
                row["switch"],
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
        for row in scene["rows"]
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
        " | ".join(f"**{cell}**" if default and cell else cell for cell in cells)
        for default, cells in rows
    ]
    return "".join(f"| {line} |\n" for line in lines)
