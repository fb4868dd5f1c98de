"""The numbers that the StereoGS paper reports, as data: data/paper_tables.yaml of this package."""

from __future__ import annotations

from importlib import resources

from ..contract.component import Settings
from ..pipeline.settings_check import validate_settings
from ..pipeline.yaml_source import parse

Triple = tuple[float, float, float]
"""PSNR in dB, SSIM, LPIPS."""
PUBLISHED_METRICS = ("psnr", "ssim", "lpips")
"""What a triple holds, as our metrics are called."""


class AblationRow(Settings):
    """One line of an ablation: what was set, and what came out by protocol."""

    setting: dict[str, str | bool | float]
    results: dict[str, Triple | None]


class Ablation(Settings):
    """One ablation table."""

    title: str
    rows: tuple[AblationRow, ...]


class Overhead(Settings):
    """What training costs, on average over a data set's scenes."""

    minutes: float
    memory_gb: float
    gaussians: int


class PaperTables(Settings):
    """All tables.

    `results` and `overhead` go by protocol, then by method; `methods` gives the methods' names.
    """

    source: str
    notes: tuple[str, ...]
    methods: dict[str, str]
    results: dict[str, dict[str, Triple | None]]
    ablations: dict[str, Ablation]
    overhead: dict[str, dict[str, Overhead]]


def paper_tables() -> PaperTables:
    """Read the file."""
    file = resources.files("registry").joinpath("data", "paper_tables.yaml")
    node = parse(file.read_text("utf-8"), "paper_tables.yaml")
    return validate_settings(PaperTables, node, "paper_tables")
