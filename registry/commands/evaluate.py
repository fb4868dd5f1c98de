"""`stereogs eval`: score a run's checkpoint again."""

from __future__ import annotations

import argparse
from pathlib import Path

from core_rasterizer import open_device

from ..plugins import Plugins
from ..runs.metrics_log import jsonable
from ..runs.results import RENDERS, describe, results_table, score
from ..runs.training_run import open_run
from .output import Verbs, add_accept_changed_inputs, add_device, add_verb, console

_EPILOG = """\
examples:
  stereogs eval runs/3dgs-fern

Renders the training and test views from the newest checkpoint, renews the scores in results.json and
the pictures, and prints the table. A run that was stopped is scored where it stands.
"""


def add(verbs: Verbs) -> None:
    """Add the verb."""
    parser = add_verb(verbs, "eval", "score a run's views again, from its checkpoint", _EPILOG)
    parser.add_argument("run_folder", type=Path, metavar="RUN", help="a run folder")
    add_accept_changed_inputs(parser)
    add_device(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Evaluate and print."""
    output = console()
    opened = open_run(
        arguments.run_folder,
        plugins=Plugins(),
        device=open_device(arguments.device),
        accept_changed_inputs=arguments.accept_changed_inputs,
    )
    opened.keep_changes()
    scores = score(opened.run, opened.parts, opened.scene, opened.model)
    facts = describe(opened.pipeline, opened.scene, opened.model, opened.checkpoint.iteration)
    changed = {"changed_inputs": opened.run.inputs()[1]}
    results = jsonable({**opened.run.results(), **facts, **changed, **scores})
    opened.run.write_results(results)
    output.print(results_table(results), soft_wrap=False)
    if opened.scene.test:
        output.print(f"pictures  {opened.run.path / RENDERS}")
    return 0
