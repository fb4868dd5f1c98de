"""Rows of papers that a page draws its curves beside: those whose time and hardware are known."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .comparing.paper_tables import PaperTables, paper_names, paper_tables
from .showing.against_time import Reference

if TYPE_CHECKING:
    from .planning.plan import Plan


def published_costs(plan: Plan) -> list[Reference]:
    """What installed papers report for the protocol that all runs follow to the letter, if there is one."""
    followed = [run.pipeline.protocol for run in plan.runs]
    names = {None if p is None or p.modified else p.protocol.name for p in followed}
    (protocol,) = names if len(names) == 1 else (None,)
    if protocol is None:
        return []
    return [row for name in paper_names() for row in _rows(paper_tables(name), protocol)]


def _rows(tables: PaperTables, protocol: str) -> list[Reference]:
    found = []
    for method, cost in tables.overhead.get(protocol, {}).items():
        numbers = tables.results.get(protocol, {}).get(method)
        if numbers is not None:
            where = f" on {tables.hardware}" if tables.hardware else ""
            label = f"{tables.methods[method]}, published: {cost.minutes:g} min{where}"
            found.append(Reference(label, dict(zip(tables.metrics, numbers, strict=True))))
    return found
