"""Tables and formatting of scores."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from registry.toolkit.web_page import Cell, note, score_table

if TYPE_CHECKING:
    from collections.abc import Mapping

_ABSENT, _INFINITE = "\u2013", "\u221e"
_UNITS = {"psnr": "dB"}


def with_unit(metric: str) -> str:
    """Return the metric's name, with its unit if it has one."""
    return f"{metric}, {_UNITS[metric]}" if metric in _UNITS else metric


def scores(results: Mapping[str, Any]) -> str:
    """Return a table of all views with the means, and the reasons for missing metrics."""
    missing: Mapping[str, str] = results.get("unavailable", {})
    metrics = list(dict.fromkeys([*results["test"], *results["train"]]))
    rows = []
    for split in ("test", "train"):
        for view, row in results["views"][split].items():
            texts = (score(row, metric, missing) for metric in metrics)
            rows.append([Cell(f"{split} {view}"), *(Cell(text) for text in texts)])
        if results[split]:
            means = (score(results[split], metric, missing) for metric in metrics)
            rows.append([Cell(text, strong=True) for text in (f"{split} mean", *means)])
    notes = "".join(note(f"{name} is not available: {reason}") for name, reason in missing.items())
    return score_table(["view", *map(with_unit, metrics)], rows) + notes if rows else ""


def score(row: Mapping[str, float | None], metric: str, missing: Mapping[str, str]) -> str:
    """Format a score. JSON has no infinity: None for an available metric means infinite."""
    value = row.get(metric)
    if value is None:
        return _INFINITE if metric in row and metric not in missing else _ABSENT
    return f"{value:.4f}" if abs(value) < 1 else f"{value:.2f}"
