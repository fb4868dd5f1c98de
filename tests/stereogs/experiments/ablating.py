"""An ablation of the toy pipeline, for tests."""

from __future__ import annotations

from pathlib import Path

from stereogs.experiments.planning.description import read_description, with_arguments
from stereogs.experiments.planning.making import make_plan
from stereogs.experiments.planning.plan import Plan
from tests.host import Plugins

PIPELINE = """\
name: toy
scene: {use: toy_scene, path: somewhere/garden}
initializer: toy_points
regularizers:
  - toy_term
  - {use: toy_term, name: second, weight: 2}
modifiers: [toy_dropout]
densification: {use: toy_growth, every: 10}
opacity: {use: toy_fade, factor: 0.9}
metrics: [psnr]
training: {iterations: 5, sh_degree: 0, seed: 7}
"""


def write(folder: Path, ablation: str | None = None) -> Path:
    """Write a pipeline, and an ablation file next to it if given; return the path of the last one."""
    (folder / "toy.yaml").write_text(PIPELINE)
    if ablation is None:
        return folder / "toy.yaml"
    path = folder / "ablation.yaml"
    path.write_text(f"pipeline: toy.yaml\n{ablation}")
    return path


def plan(
    path: Path,
    plugins: Plugins,
    *,
    toggles: str | None = None,
    vary: tuple[str, ...] = (),
    scenes: str | None = None,
    seeds: int | None = None,
    overrides: tuple[str, ...] = (),
) -> Plan:
    """Return the plan of a file and command line arguments."""
    description = with_arguments(
        read_description(path),
        overrides=overrides,
        toggles=toggles,
        vary=vary,
        scenes=scenes,
        seeds=seeds,
    )
    return make_plan(description, plugins)
