"""Scores of a trial, and what a result must state."""

from __future__ import annotations

import platform
import re
from pathlib import Path
from typing import Any

from core_rasterizer import Engine, Gaussians
from registry import RunError
from registry.calls.process_state import one_torch_thread
from registry.pipeline.parts import Parts
from registry.pipeline.pipeline import Pipeline
from registry.runs.evaluation import Scores, evaluate
from registry.runs.origin import circumstances, input_digests
from registry.system.cores import usable_cores
from registry.system.files import jsonable
from registry.system.memory import machine_memory
from registry.training.initial_model import new_model

_SOFTWARE = ("engine", "python", "source", "packages", "plugins", "plugin_sources")


def score(gaussians: Gaussians, scene: Any, parts: Parts, engine: Engine) -> dict[str, Any]:
    """Return the scores of the test views of a scene, in whose coordinates the Gaussians are."""
    model = new_model(gaussians, parts.pipeline.training, engine)
    with one_torch_thread():
        return scores_of(evaluate(model, scene, scene.test, parts["metrics"]), parts.pipeline)


def scores_of(scores: Scores, pipeline: Pipeline) -> dict[str, Any]:
    """Return means and views of scores.

    Raises:
        ExplainedError: a metric failed, or no view is held out.
    """
    if failed := next(iter(scores.failures.values()), None):
        raise failed
    if not scores.views:
        raise RunError(
            "the scene has no test views to score",
            where=pipeline.name,
            fix="name a protocol that holds some out, and check the folder with `stereogs data check`",
        )
    found = {"test": scores.mean, "views": scores.views, "unavailable": scores.unavailable}
    return dict(jsonable(found))


def about(pipeline: Pipeline, parts: Parts, scene: Any, engine: Engine) -> dict[str, Any]:
    """Return protocol, data, machine and software of a result.

    Raises:
        RunError: the pipeline follows no protocol.
    """
    if pipeline.protocol is None:
        fix = "name one in the benchmark file"
        raise RunError("the pipeline follows no protocol", where=pipeline.name, fix=fix)
    around = circumstances(pipeline, engine)
    memory = machine_memory()
    digests = input_digests(scene, pipeline)
    views = {view.name for view in scene.test}
    return {
        "protocol": pipeline.protocol.record(),
        "inputs": {k: v for k, v in digests.items() if k.partition(" of ")[2] in views},
        "machine": {
            "device": around["device"],
            "processor": _processor(),
            "cores": usable_cores(),
            "memory_gb": None if memory is None else round(memory / 1e9),
            "system": platform.system(),
        },
        "software": {name: around[name] for name in _SOFTWARE if name != "plugins"},
        "command": around["command"],
    }


def _processor() -> str:
    file = Path("/proc/cpuinfo")
    text = file.read_text("utf-8") if file.is_file() else ""
    found = re.search(r"^model name\s*: (.*)$", text, re.MULTILINE)
    return found[1] if found else platform.processor() or platform.machine()
