"""Trainings of `make bench-skips`: `weightfree_fast`, and a variant of it for each of its shortcuts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

from benchmarks.trainings import DATA, SEEDS, Case, Method, Training, written_digest
from registry.discovery import Plugins
from registry.pipeline.edits import apply_override
from registry.pipeline.pipeline import checked_pipeline, load_pipeline
from registry.pipeline.yaml_source import Node, parse
from stereogs.quality.table import SHORT


class Shortcut(NamedTuple):
    """One shortcut.

    Args:
        label: Label in the table.
        length: Length of the run as a share of the pipeline's.
        overrides: Overrides as for `--set`.
        disabled: Components to switch off.
    """

    label: str
    length: float = 1.0
    overrides: tuple[str, ...] = ()
    disabled: tuple[str, ...] = ()


def _case(data: str, name: str, views: int, scene: str) -> tuple[str, Case]:
    override = f"scene={{name: {name}, path: '${{{DATA}}}/{data}', {scene}}}"
    return name, Case(data, views, "", (override,))


CASES = dict(
    (
        _case("llff_fern", "fern-3", 3, "use: llff, train_views: 3"),
        _case("dtu_scan24", "dtu24-6", 6, "use: dtu, train_views: 6"),
        _case(
            "blender_lego",
            "lego-8",
            8,
            "use: blender, train_ids: [2, 16, 26, 55, 73, 76, 86, 93], test_every: 8, background: white",
        ),
    )
)
"""Scenes of three kinds by name."""
DEFAULT = "default"
SHORTCUTS = (
    Shortcut(DEFAULT),
    Shortcut("half as many iterations", length=0.5),
    Shortcut("twice as many iterations", length=2.0),
    Shortcut("no growth", disabled=("gradient_threshold",)),
    Shortcut("no decay", disabled=("gradient_aware_decay",)),
    Shortcut("no dropout, no scaling at the end", disabled=("dropout", "expected_opacity")),
    Shortcut("dropout without scaling at the end", disabled=("expected_opacity",)),
    Shortcut("colours without direction (SH degree 0)", overrides=("training.sh_degree=0",)),
    Shortcut("a point every 4th pixel, not every 3rd", overrides=("initializer.stride=4",)),
    Shortcut("no limit of size", disabled=("size_limit",)),
    Shortcut("no margin around the views", overrides=("initializer.margin=false",)),
    Shortcut("photographs of full size from the start", disabled=("resolution_schedule",)),
    Shortcut("L1 alone in the loss", overrides=("training.ssim_weight=0",)),
)


def planned_runs(plugins: Plugins, seeds: Iterable[int] = SEEDS) -> list[Training]:
    """Return the checked trainings. Switches take turns, so a busy hour affects all of them.

    Raises:
        PipelineError: a switch names what the pipeline does not have.
    """
    return [
        _planned(name, switch, seed, plugins)
        for seed, name, switch in product(seeds, CASES, SHORTCUTS)
    ]


def variant(switch: Shortcut, plugins: Plugins) -> Node:
    """Return the pipeline with one switch, as a tree; schedules are scaled to its length."""
    overrides = ["scene=procedural", "metrics=[psnr, ssim]", *switch.overrides]
    pipeline = load_pipeline(Path(SHORT), plugins, overrides=overrides, disabled=switch.disabled)
    made = pipeline.scaled(round(switch.length * pipeline.training.iterations))
    if pipeline.iterations_per_view is not None:
        per_view = round(switch.length * pipeline.iterations_per_view)
        made = replace(made, iterations_per_view=per_view)
    return parse(made.to_yaml(), switch.label)


def _planned(name: str, switch: Shortcut, seed: int, plugins: Plugins) -> Training:
    case, tree = CASES[name], variant(switch, plugins)
    for override in (*case.overrides, f"training.seed={seed}"):
        apply_override(tree, override)
    digest = written_digest(tree)
    identity = {"switch": switch.label, "data": case.data, "seed": seed}
    method = Method(switch.label, Path(SHORT), baseline=switch.label == DEFAULT)
    pipeline = checked_pipeline(tree, plugins)
    return Training(f"{name}_{seed}_{digest}", identity, case, method, seed, pipeline, digest)
