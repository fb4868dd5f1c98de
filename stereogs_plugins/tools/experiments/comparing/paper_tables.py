"""Numbers that papers report, as data that any package may bring.

A package names an entry point in the group `stereogs.paper_tables`: its name is the paper's, its value
the package in which the file NAME.yaml lies. The file is a `PaperTables`.
"""

from __future__ import annotations

from importlib import resources
from importlib.metadata import entry_points
from typing import Self

from pydantic import Field, model_validator

from registry import RunError, Settings
from registry.messages import did_you_mean, listing
from registry.pipeline import parse, validate_settings

GROUP = "stereogs.paper_tables"

Numbers = tuple[float, ...]
"""One for each of the paper's metrics."""


class AblationRow(Settings):
    """One line of an ablation: what was set, and what came out by protocol."""

    setting: dict[str, str | bool | float]
    results: dict[str, Numbers | None]


class Ablation(Settings):
    """One ablation table."""

    title: str
    note: str = ""
    rows: tuple[AblationRow, ...]


class Overhead(Settings):
    """What training costs, on average over a data set's scenes."""

    minutes: float
    memory_gb: float
    gaussians: int


class PaperTables(Settings):
    """All tables of a paper.

    `metrics` names what the numbers are, as pipelines name metrics. `results` and `overhead` go by
    protocol, then by method; `methods` gives the methods' names, `protocol_notes` what a reader of one
    protocol's rows must know, `notes` of any; `hardware` is what `overhead` was measured on.
    """

    source: str
    metrics: tuple[str, ...]
    notes: tuple[str, ...] = ()
    protocol_notes: dict[str, str] = Field(default_factory=dict)
    methods: dict[str, str]
    results: dict[str, dict[str, Numbers | None]]
    ablations: dict[str, Ablation] = Field(default_factory=dict)
    overhead: dict[str, dict[str, Overhead]] = Field(default_factory=dict)
    hardware: str = ""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        rows = [numbers for methods in self.results.values() for numbers in methods.values()]
        rows += [n for a in self.ablations.values() for r in a.rows for n in r.results.values()]
        if any(numbers is not None and len(numbers) != len(self.metrics) for numbers in rows):
            raise ValueError(f"each row has {len(self.metrics)} numbers, or is null")
        unknown = {m for methods in self.results.values() for m in methods} - self.methods.keys()
        if unknown:
            raise ValueError(f"`methods` gives no name to {listing(sorted(unknown))}")
        return self


def paper_names() -> tuple[str, ...]:
    """The papers whose tables are installed, sorted."""
    return tuple(sorted({entry.name for entry in entry_points(group=GROUP)}))


def paper_tables(name: str) -> PaperTables:
    """The tables of a paper.

    Raises:
        RunError: no installed package, or more than one, brings them, or the one lacks the file.
        PipelineError: the file is not what it should be; with its line.
    """
    found = entry_points(group=GROUP, name=name)
    if len(found) != 1:
        owners = " and ".join(entry.dist.name for entry in found if entry.dist)
        what = f"the tables of {name!r} are brought twice: by {owners}"
        if not found:
            what = f"no tables of a paper {name!r} are installed{did_you_mean(name, paper_names())}"
        raise RunError(what, where="--paper", fix=f"papers: {listing(paper_names())}")
    (entry,) = found
    try:
        text = resources.files(entry.value).joinpath(f"{name}.yaml").read_text("utf-8")
    except (ImportError, OSError) as error:
        raise RunError(
            f"the tables of {name!r} cannot be read: {error}",
            where=f"entry point {GROUP}: {name} = {entry.value}",
            fix="mend or update the package that brings them",
        ) from error
    return validate_settings(PaperTables, parse(text, f"{name}.yaml"), "paper_tables")
