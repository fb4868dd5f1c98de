"""A run folder as training leaves it, for what reads one."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from ..pipeline.training_settings import TrainingSettings
from ..runs.options import RunOptions
from ..runs.training_run import start
from .bench import Bench
from .companions import pipeline_of


@contextmanager
def finished_run(bench: Bench) -> Iterator[Path]:
    """The folder of a run of three iterations; where nothing is in view, of one without test views."""
    scene = replace(bench.scene, points=bench.points())
    if bench.size.hidden:
        scene = replace(scene, test=())
    pipeline = pipeline_of([], TrainingSettings(iterations=3, sh_degree=1))
    with tempfile.TemporaryDirectory() as name:
        run = start(
            pipeline,
            RunOptions(scene=scene, device=bench.device, progress=False),
            Path(name) / "run",
        )
        yield run.folder_or_refuse().path
