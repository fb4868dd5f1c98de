"""The scores of a results.json as a table."""

from __future__ import annotations

from typing import Any

from rich.table import Table

ABSENT = "\u2013"
"""What tables show, a dash, where a score is not available."""


def results_table(results: dict[str, Any]) -> Table:
    """The scores of a results.json as a table: a row a test view, then the means."""
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
    """A score to four digits; None is infinite, for which JSON has no number."""
    return "inf" if value is None else f"{value:.4f}" if abs(value) < 1 else f"{value:.2f}"
