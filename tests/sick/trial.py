"""Train with a component made from a template, and tell what the host said about it."""

from __future__ import annotations

import atexit
import hashlib
import importlib
import logging
import os
import random
import shutil
import signal
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from unittest import mock

import numpy as np
import torch

from core_rasterizer import Device, ExplainedError, open_device
from registry.runs import read_results
from registry.testing import check, tiny_scene
from registry.testing.processes import in_other_processes
from registry.testing.scenes import pipeline_item, pipeline_of
from stereogs import Pipeline, RunOptions
from tests.host import TrainingSettings, refuse_different_answers, start_run
from tests.sick.cases import Case

Verdict = Literal["named", "warned", "refused", "crash", "harmless", "silent"]
"""named: an error, or a failure in the results, names the component. warned: a warning does. refused: an
error without its name. crash: another exception. harmless: the numbers are those of the run without the
fault. silent: they differ."""

NAME = "sick_one"
AS_COMMAND = ("0", "0")
"""PYTHONHASHSEED of the two processes that are compared: the command `stereogs` fixes it."""
_TRAINING = TrainingSettings(iterations=12, sh_degree=0, evaluate_every=6)
_MODULES = Path(tempfile.mkdtemp(prefix="sick-"))
"""Modules of the components: other processes import them too."""
sys.path.insert(0, str(_MODULES))
atexit.register(shutil.rmtree, _MODULES, ignore_errors=True)
_HEAD = """\
import os, random, signal, sys, threading, time, warnings
from dataclasses import replace
import numpy as np
import torch
import registry
from core_rasterizer import Edit
from registry.priors import DepthMap


class Sick(registry.{base}[registry.Settings]):
    called = 0
    hook = None
    gain = torch.tensor(1.1, requires_grad=True)

    def term(self, step):
        alpha = step.rendering.alpha
        if self.hook is not None:
            alpha = alpha.clone()
            alpha.register_hook(self.hook)
        return alpha.mean()

    def written(self, file):
        file.write_text("x")
        return file

    def {method}:
        self.called += 1
        {before}
        {fault}
        return {answer}
"""


@dataclass(frozen=True)
class _Template:
    base: str
    method: str
    answer: str
    before: str = "pass"


_TEMPLATES = {
    "samplers": _Template("Sampler", "sample(self, step, sample)", "sample"),
    "modifiers": _Template(
        "Modifier", "opacity_scale(self, step)", "torch.full((step.model.count,), 0.9)"
    ),
    "appearances": _Template("Appearance", "colors(self, step, rgb)", "rgb * 1.1"),
    "regularizers": _Template("Regularizer", "loss(self, step)", "self.term(step)"),
    "densification": _Template("Densification", "refine(self, step)", "None"),
    "opacity": _Template("OpacityPolicy", "update(self, step)", "None"),
    "perturbations": _Template("Perturbation", "offsets(self, step)", "{}"),
    "metrics": _Template(
        "Metric", "measure(self, rendered, photograph, mask)", "float(photograph.mean())"
    ),
    "observers": _Template("Observer", "iterated(self, done)", "None"),
    "exporters": _Template(
        "Exporter", "export(self, model, scene, folder)", "[self.written(folder / 'a.txt')]"
    ),
    "reports": _Template(
        "Report", "write(self, folder, scene)", "[self.written(folder / 'b.txt')]"
    ),
    "initializer": _Template(
        "Initializer", "initialize(self, scene, priors)", "points", "points = scene.points"
    ),
}


def component(case: Case, *, healthy: bool = False) -> type[Any]:
    """Return the component's class, or its twin without the fault."""
    template = _TEMPLATES[case.section]
    twin = healthy and case.compared == "twin"
    source = _HEAD.format(
        base=template.base,
        method=template.method,
        before=template.before,
        fault="pass" if twin else case.fault,
        answer=template.answer if twin or not case.answer else case.answer,
    )
    name = f"sick_{hashlib.sha256(source.encode()).hexdigest()[:12]}"
    file = _MODULES / f"{name}.py"
    if not file.exists():
        file.write_text(source)
        importlib.invalidate_caches()
    made: type[Any] = importlib.import_module(name).Sick
    return made


def verdict(case: Case, device: Device, *, checked: bool = False) -> Verdict:
    """Train with the component; `checked` as with --check-plugins."""
    try:
        with _logged() as lines:
            numbers = _trained(case, component(case), device, checked)
    except ExplainedError as error:
        return "named" if NAME in f"{error.what} {error.where}" else "refused"
    except BaseException:
        return "crash"
    if NAME in numbers.pop("failures"):
        return "named"
    if any(NAME in line for line in lines):
        return "warned"
    if case.compared == "again":
        if checked and _refused_between_processes(case, device):
            return "named"
        # No answers: refused there, after it went unnoticed here.
        with mock.patch("registry.testing.processes.SEEDS", AS_COMMAND):
            answers = in_other_processes(_numbers, case, checked, str(_MODULES))
        expected, numbers = answers or ({}, numbers)
    else:
        expected = _trained(case, component(case, healthy=True), device, checked)
    return "harmless" if expected.items() >= numbers.items() else "silent"


def _refused_between_processes(case: Case, device: Device) -> bool:
    """Whether `train --check-plugins` names the component before the first iteration."""
    try:
        refuse_different_answers(_pipeline(case, component(case)), tiny_scene(), device.name)
    except ExplainedError as error:
        return NAME in error.where
    return False


def _numbers(case: Case, checked: bool, modules: str) -> dict[str, Any]:
    """Return the numbers of a run, for `in_other_processes`."""
    sys.path.insert(0, modules)
    return _trained(case, component(case), open_device(), checked)


def found_by_check(case: Case, device: Device) -> bool:
    """Whether `registry.testing.check` refuses the component."""
    with _restored():
        try:
            check(component(case), device=device)
        except BaseException:
            return True
    return False


def _pipeline(case: Case, sick: type[Any]) -> Pipeline:
    item = pipeline_item(sick, sick.Settings(), NAME)
    training = _TRAINING.model_copy(update={"iterations": case.iterations})
    pipeline = pipeline_of([item], training)
    metrics = pipeline_of([], training).items["metrics"]
    if item.point.section == "metrics":
        pipeline.items["metrics"] = (item, *metrics)
    return pipeline


def _trained(case: Case, sick: type[Any], device: Device, checked: bool) -> dict[str, Any]:
    """Return the numbers of a run that its other components made."""
    scene, pipeline = tiny_scene(), _pipeline(case, sick)
    options = RunOptions(scene=scene, device=device, progress=False, check_plugins=checked)
    with tempfile.TemporaryDirectory() as name, _restored():
        run = start_run(pipeline, options, Path(name) / "run")
        results = read_results(Path(name) / "run/results.json")
        rows = [row["mean_error"] for split in results["views"].values() for row in split.values()]
        photographs = [float(view.image.sum()) for view in (*run.scene.train, *run.scene.test)]
        failures = " ".join(str(failure) for failure in results["failures"])
        return {
            "hash": run.hash,
            "scores": rows,
            "photographs": photographs,
            "own": results["test"].get(NAME) if case.compared == "again" else None,
            "failures": failures,
        }


@contextmanager
def _logged() -> Iterator[list[str]]:
    lines: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: lines.append(record.getMessage())  # type: ignore[method-assign]
    log = logging.getLogger("stereogs")
    log.addHandler(handler)
    try:
        yield lines
    finally:
        log.removeHandler(handler)


@contextmanager
def _restored() -> Iterator[None]:
    """Restore the process's state, which sick components change."""
    folder, environment, mask = Path.cwd(), dict(os.environ), os.umask(0o22)
    handler, limit = signal.getsignal(signal.SIGUSR2), sys.getrecursionlimit()
    states = torch.default_generator.get_state(), np.random.get_state(), random.getstate()
    with warnings.catch_warnings(), np.errstate():
        try:
            yield
        finally:
            os.chdir(folder)
            os.environ.clear()
            os.environ.update(environment)
            os.umask(mask)
            signal.signal(signal.SIGUSR2, handler)
            sys.setrecursionlimit(limit)
            torch.set_default_device(None)
            torch.set_default_dtype(torch.float32)
            torch.set_grad_enabled(True)
            with suppress(ValueError):
                torch.default_generator.set_state(states[0])
                np.random.set_state(states[1])
                random.setstate(states[2])
