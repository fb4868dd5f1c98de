"""`html`: a run as one page, report.html: scores, pictures, how training went, and what was run.

The page holds its pictures itself (as JPEG), so that it can be mailed or moved away from its run. It has
no script and asks the network for nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from registry import Register, Report, Scene, Settings, hookimpl, write_text
from registry.web_page import (
    Cell,
    facts_table,
    figure,
    grid,
    image,
    note,
    page,
    score_table,
    section,
    verbatim,
)

from .run_files import RunFiles, read_run
from .training_plots import training_plots

FILE = "report.html"

_ABSENT, _INFINITE = "\u2013", "\u221e"


class HtmlReport(Report[Settings]):
    """Writes report.html into the run folder."""

    def write(self, folder: Path, scene: Scene) -> list[Path]:
        """Return report.html.

        Raises:
            RunError: a file of the run is missing or damaged.
        """
        run = read_run(folder)
        title = f"{scene.name}: {run.results['pipeline']}"
        contents = [
            _summary(run.results),
            section("Scores", _scores(run.results)),
            section("Test views: photograph, render, depth", _views(run, scene)),
            section("Training", grid(training_plots(run.metrics))),
            section("Initialization", _initialization(run)),
            section("Pipeline", verbatim(run.pipeline)),
            section("Scene", facts_table(run.results["scene"])),
            section("Provenance", facts_table(run.provenance)),
        ]
        write_text(folder / FILE, page(title, contents))
        return [folder / FILE]


def _summary(results: Mapping[str, Any]) -> str:
    """What was trained, and what it took; a run that was scored half-way has no time yet."""
    labels = {
        "gaussians": "Gaussians",
        "iterations": "iterations",
        "seconds": "training time, s",
        "iterations_per_second": "iterations per second",
        "peak_memory_mb": "peak memory, MB",
        "hash": "SHA-256 of the Gaussians",
    }
    return facts_table({label: results[key] for key, label in labels.items() if key in results})


def _scores(results: Mapping[str, Any]) -> str:
    """Each view of both splits, the means below them, and why a metric is missing."""
    missing: Mapping[str, str] = results.get("unavailable", {})
    metrics = list(dict.fromkeys([*results["test"], *results["train"]]))
    rows = []
    for split in ("test", "train"):
        for view, row in results["views"][split].items():
            scores = (_score(row, metric, missing) for metric in metrics)
            rows.append([Cell(f"{split} {view}"), *(Cell(score) for score in scores)])
        if results[split]:
            means = (_score(results[split], metric, missing) for metric in metrics)
            rows.append([Cell(text, strong=True) for text in (f"{split} mean", *means)])
    notes = "".join(note(f"{name} is not available: {reason}") for name, reason in missing.items())
    return score_table(["view", *metrics], rows) + notes if rows else ""


def _score(row: Mapping[str, float | None], metric: str, missing: Mapping[str, str]) -> str:
    """Four digits. JSON has no infinity: what is None although it was measured is infinite."""
    value = row.get(metric)
    if value is None:
        return _INFINITE if metric in row and metric not in missing else _ABSENT
    return f"{value:.4f}" if abs(value) < 1 else f"{value:.2f}"


def _views(run: RunFiles, scene: Scene) -> str:
    missing: Mapping[str, str] = run.results.get("unavailable", {})
    figures = []
    for view in scene.test:
        path = run.renders.get(view.name)
        if path is not None:
            row = run.results["views"]["test"].get(view.name, {})
            scores = [f"{metric} {_score(row, metric, missing)}" for metric in row]
            figures.append(_picture(path, ", ".join([view.name, *scores])))
    return "\n".join(figures)


def _initialization(run: RunFiles) -> str:
    pictures = [_picture(path, path.stem) for path in run.initial_pictures]
    return facts_table(run.initialization) + "".join(pictures)


def _picture(path: Path, caption: str) -> str:
    return figure(caption, image(path, caption))


@hookimpl
def stereogs_register_reports(register: Register[HtmlReport]) -> None:
    register("html", HtmlReport)
