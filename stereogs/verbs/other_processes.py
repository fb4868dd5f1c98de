"""`train --check-plugins` also compares the answers of components in two other processes."""

from __future__ import annotations

import argparse
import logging
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any

from registry import PluginError

from ..command_line.command import TrainOption

if TYPE_CHECKING:
    from registry import Scene
    from registry.pipeline.pipeline import Item, Pipeline
    from registry.runs.options import RunOptions
    from registry.runs.run import Run

    from ..command_line.command import TrainRequest

ITERATIONS = 24
"""Length of the trainings; schedules are scaled to it, so that late components are called too."""
_HASH_SEED = "PYTHONHASHSEED"
HASH_SEEDS = ("1", "2")
"""Values of `_HASH_SEED` in the processes: it decides `hash()` of texts, and the order of sets."""
_LEFT_OUT = ("exporters", "reports", "observers")
"""Sections whose answers do not decide the result."""
_log = logging.getLogger("stereogs")

Answer = tuple[str, dict[str, str]]
"""Qualified name of a component, and digests of the parts of its answer."""


class OtherProcesses(TrainOption):
    """Part of `--check-plugins`, an option of the host."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add nothing."""

    @contextmanager
    def running(self, request: TrainRequest, options: RunOptions) -> Iterator[RunOptions]:
        """Compare before the first iteration if plugins are checked."""
        before = options.on_begin

        def begin(run: Run) -> None:
            refuse_different_answers(run.pipeline, run.scene, run.engine_model.engine.device.name)
            if before is not None:
                before(run)

        yield replace(options, on_begin=begin) if options.check_plugins else options


def refuse_different_answers(pipeline: Pipeline, scene: Scene, device: str) -> None:
    """Train in two processes with different numbers and hash seeds, and compare all answers.

    The trainings have `ITERATIONS` iterations and score one test view. If a process fails, nothing is
    compared, and a warning says so.

    Args:
        device: name of the OpenCL device.

    Raises:
        PluginError: an answer differs; names the first component.
    """
    from registry.calls.blame import blame as blamed

    none: dict[str, tuple[Item, ...]] = dict.fromkeys(_LEFT_OUT, ())
    short = replace(pipeline, items=pipeline.items | none, protocol=None).scaled(ITERATIONS)
    few = replace(scene, test=scene.test[:1])
    try:
        answers = [_in_process(seed, short, few, device) for seed in HASH_SEEDS]
    except Exception as error:  # the run itself reports errors of its components
        _log.warning("answers were not compared between processes: %s", error)
        return
    for (name, digests), other in zip(*answers, strict=False):
        if (name, digests) != other:
            (item,) = (item for item in pipeline if item.qualified_name == name)
            with blamed(item):
                raise PluginError(
                    "it gave different answers in two processes: no run could be repeated or resumed",
                    fix="sort sets before you iterate over them, and use neither hash(), id() nor the "
                    "process's number",
                )


def _in_process(seed: str, *given: Any) -> Sequence[Answer]:
    before = os.environ.get(_HASH_SEED)
    os.environ[_HASH_SEED] = seed  # a new process reads it when it starts
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            return pool.submit(answers_of, *given).result()
    finally:
        if before is None:
            del os.environ[_HASH_SEED]
        else:
            os.environ[_HASH_SEED] = before


def answers_of(pipeline: Pipeline, scene: Scene, device: str) -> Sequence[Answer]:
    """Train and score, and return all answers of the components in their order."""
    from ..session import train

    answers: list[Answer] = []
    items = {
        section: tuple(
            _recording(item, answers) if item.point.method else item for item in of_section
        )
        for section, of_section in pipeline.items.items()
    }
    run = train(replace(pipeline, items=items), scene=scene, device=device, progress=False)
    _ = run.scores
    return answers


def _recording(item: Item, answers: list[Answer]) -> Item:
    """Return the item with a subclass of its component that adds its answers to the list."""
    from registry.calls.repeats import digests, is_record

    component = item.offer.component
    name = item.point.method
    method = getattr(component, name)

    def recorded(self: Any, *given: Any) -> Any:
        answer = method(self, *given)
        parts = digests(answer).items()
        kept = {part: digest for part, digest in parts if not is_record(part)}
        answers.append((item.qualified_name, kept))
        return answer

    own = {name: recorded, "__module__": component.__module__}
    kind = type(component.__name__, (component,), own)
    return replace(item, offer=replace(item.offer, component=kind))
