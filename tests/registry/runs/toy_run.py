"""A short run of toy components, from its start or resumed."""

from __future__ import annotations

import io
from pathlib import Path

from rich.console import Console

from core_rasterizer import Device
from registry.runs.folder import RunFolder
from registry.runs.options import RunOptions
from registry.runs.run import Run
from registry.runs.training_run import continue_run, start_run
from stereogs import Pipeline
from tests.host import Plugins, parse_pipeline

TEXT = """\
name: toy
scene: {use: toy_scene, path: here}
initializer: toy_points
regularizers: [{use: toy_term, weight: 0.1}]
modifiers: [toy_dropout]
densification: {use: toy_growth, every: 10, stop: 25}
opacity: {use: toy_fade, every: 7}
metrics: [psnr]
exporters: [toy_files]
reports: [toy_report]
training: {iterations: 30, sh_degree: 1, sh_every: 10, evaluate_every: 20}
"""


def pipeline(plugins: Plugins, *overrides: str) -> Pipeline:
    """Return the pipeline of the toy run."""
    return parse_pipeline(TEXT, plugins, source="toy.yaml", overrides=overrides)


def run(
    plugins: Plugins, device: Device, out: Path, *overrides: str
) -> tuple[RunFolder, bool, str]:
    """Train; return the folder, whether the run is finished, and the output."""
    stream = io.StringIO()
    options = RunOptions(device=device, progress=Console(file=stream))
    done = start_run(pipeline(plugins, *overrides), options, out)
    return done.folder_or_refuse(), done.finished, stream.getvalue()


def resumed(path: Path, plugins: Plugins, device: Device) -> Run:
    """Resume the run from its newest checkpoint."""
    return continue_run(path, RunOptions(device=device, progress=False), plugins)
