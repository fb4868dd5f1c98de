"""Tables and formatting of scores."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from registry.runs import score_of
from registry.toolkit.web_page import Cell, facts_table, note, score_table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_ABSENT, _INFINITE = "\u2013", "\u221e"
_UNITS = {"psnr": "dB"}
_KINDS = {"test": "held-out photographs", "train": "training photographs"}
_COSTS = {
    "gaussians": "Gaussians",
    "iterations": "iterations",
    "seconds": "training time, s",
    "iterations_per_second": "iterations per second",
    "peak_memory_mb": "peak memory, MB",
}


def with_unit(metric: str) -> str:
    """Return the metric's name, with its unit if it has one."""
    return f"{metric}, {_UNITS[metric]}" if metric in _UNITS else metric


def summary(results: Mapping[str, Any]) -> str:
    """Return tables of mean scores and of known costs, and why metrics are missing."""
    missing: Mapping[str, str] = results.get("unavailable", {})
    metrics = [
        name
        for name in _metrics(results)
        if any(score_of(results, split, name) is not None for split in _KINDS)
    ]
    rows = [
        [Cell(f"{kind} ({_counted(results, split)})"), *_cells(results, split, metrics)]
        for split, kind in _KINDS.items()
        if results[split]
    ]
    means = score_table(["mean of", *map(with_unit, metrics)], rows) if rows and metrics else ""
    costs = {label: results[key] for key, label in _COSTS.items() if key in results}
    notes = "".join(note(f"{name} is not available: {reason}") for name, reason in missing.items())
    return means + notes + facts_table(costs)


def _counted(results: Mapping[str, Any], split: str) -> str:
    count = str(len(results["views"][split]))
    if split == "train" and results.get("train_scored"):
        return f"{count} of {len(results['scene'][split])}, evenly spaced"
    return count


def views(results: Mapping[str, Any]) -> str:
    """Return a table of the scores of all photographs."""
    metrics = _metrics(results)
    rows = [
        [Cell(view), Cell(kind), *_cells(results, split, metrics, view)]
        for split, kind in _KINDS.items()
        for view in results["views"][split]
    ]
    return score_table(["view", "kind", *map(with_unit, metrics)], rows, names=2) if rows else ""


def _metrics(results: Mapping[str, Any]) -> list[str]:
    return list(dict.fromkeys([*results["test"], *results["train"]]))


def _cells(
    results: Mapping[str, Any], split: str, metrics: Sequence[str], view: str | None = None
) -> list[Cell]:
    return [Cell(score(results, split, metric, view)) for metric in metrics]


def score(results: Mapping[str, Any], split: str, metric: str, view: str | None = None) -> str:
    """Format a view's score, or by default the mean."""
    value = score_of(results, split, metric, view)
    if value is None or math.isinf(value):
        return _ABSENT if value is None else _INFINITE
    return f"{value:.4f}" if abs(value) < 1 else f"{value:.2f}"
