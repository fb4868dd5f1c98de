"""Published numbers, which any package can provide.

An entry point of the group `stereogs.paper_tables` has the name of the paper, and as value the package with
the file NAME.yaml, which holds `PaperTables`.
"""

from __future__ import annotations

from importlib import resources
from importlib.metadata import entry_points
from typing import Self

from pydantic import Field, model_validator

from registry import RunError, Settings
from registry.messages.suggestions import did_you_mean, listing
from registry.pipeline.settings_check import validate_settings
from registry.pipeline.yaml_source import parse

GROUP = "stereogs.paper_tables"

Numbers = tuple[float, ...]
"""A number per metric of the paper."""


class AblationRow(Settings):
    """A row of an ablation: its settings, and its numbers by protocol."""

    setting: dict[str, str | bool | float]
    results: dict[str, Numbers | None]


class Ablation(Settings):
    """An ablation table."""

    title: str
    note: str = ""
    rows: tuple[AblationRow, ...]


class Overhead(Settings):
    """The cost of training, averaged over the scenes of a data set."""

    minutes: float
    memory_gb: float
    gaussians: int


class PaperTables(Settings):
    """All tables of a paper.

    `metrics` has the names of metrics in pipelines; keys of `results` and `overhead` are protocols, then
    methods. `methods` maps methods to their names, `protocol_notes` has notes on the rows of a protocol,
    `notes` on all rows; `hardware` is the hardware of `overhead`.
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
            raise ValueError(f"each row must have {len(self.metrics)} numbers, or be null")
        unknown = {m for methods in self.results.values() for m in methods} - self.methods.keys()
        if unknown:
            raise ValueError(f"`methods` lacks {listing(sorted(unknown))}")
        return self


def paper_names() -> tuple[str, ...]:
    """Return the papers with installed tables, sorted."""
    return tuple(sorted({entry.name for entry in entry_points(group=GROUP)}))


def paper_tables(name: str) -> PaperTables:
    """Return the tables of a paper.

    Raises:
        RunError: no package or several packages provide them, or the file is missing.
        PipelineError: the file is invalid; names the line.
    """
    found = entry_points(group=GROUP, name=name)
    if len(found) != 1:
        owners = " and ".join(entry.dist.name for entry in found if entry.dist)
        what = f"several packages provide the tables of {name!r}: {owners}"
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
            fix="fix or update the package that provides them",
        ) from error
    return validate_settings(PaperTables, parse(text, f"{name}.yaml"), "paper_tables")
