"""Scores as a table, and as text."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from registry.toolkit.web_page import Cell, note, score_table

if TYPE_CHECKING:
    from collections.abc import Mapping

_ABSENT, _INFINITE = "\u2013", "\u221e"


_UNITS = {"psnr": "dB"}


def with_unit(metric: str) -> str:
    """The metric's name, and its unit if it has one."""
    return f"{metric}, {_UNITS[metric]}" if metric in _UNITS else metric


def scores(results: Mapping[str, Any]) -> str:
    """Each view of both splits, the means below them, and why a metric is missing."""
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
    """Four digits. JSON has no infinity: what is None although it was measured is infinite."""
    value = row.get(metric)
    if value is None:
        return _INFINITE if metric in row and metric not in missing else _ABSENT
    return f"{value:.4f}" if abs(value) < 1 else f"{value:.2f}"
