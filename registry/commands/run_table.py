"""Table of the scores in a results.json."""

from __future__ import annotations

from typing import Any

from rich.table import Table

ABSENT = "\u2013"
"""Shown in tables if a score is not available: a dash."""


def results_table(results: dict[str, Any]) -> Table:
    """Return the scores of a results.json as a table: one row per test view, then the means."""
    metrics = list(results["train"] | results["test"])
    missing: dict[str, str] = results["unavailable"]
    table = Table(
        title=f"{results['scene']['name']}, {results['pipeline']}",
        caption="\n".join(f"{ABSENT} {name}: {reason}" for name, reason in missing.items()) or None,
    )
    table.add_column("view")
    for name in metrics:
        table.add_column(name, justify="right")

    def add(label: str, row: dict[str, float | None]) -> None:
        table.add_row(label, *(_cell(row, name, missing) for name in metrics))

    for view, row in results["views"]["test"].items():
        add(view, row)
    table.add_section()
    for label, split in (("test mean", "test"), ("train mean", "train")):
        if results[split]:
            add(label, results[split])
    return table


def _cell(row: dict[str, float | None], name: str, missing: dict[str, str]) -> str:
    value = row.get(name)
    if value is None and (name not in row or name in missing):
        return ABSENT
    return _score(value)


def _score(value: float | None) -> str:
    """Format a score to four digits; None is infinite."""
    return "inf" if value is None else f"{value:.4f}" if abs(value) < 1 else f"{value:.2f}"
