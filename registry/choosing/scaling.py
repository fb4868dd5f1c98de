"""A pipeline at another length: every moment of its schedules where it was, as a part of the run."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

from ..pipeline.pipeline import Item, Pipeline
from ..pipeline.schedule import HostSettings
from ..pipeline.training_settings import TrainingSettings


def scaled(pipeline: Pipeline, iterations: int) -> Pipeline:
    """The pipeline with so many iterations, and its schedules in proportion, rounded down.

    `--set training.iterations=N` moves only what is written as a share. Here moments that are written as
    numbers move too: what begins in iteration 100 of 400 begins in 50 of 200. What holds for the first
    iteration or for each one stays so. The pipeline's own length gives the pipeline itself.

    Args:
        iterations: >= 1.
    """
    factor = Fraction(iterations, pipeline.training.iterations)
    if factor == 1:
        return pipeline
    items = {
        section: tuple(_item(item, factor) for item in items)
        for section, items in pipeline.items.items()
    }
    return replace(pipeline, items=items, training=_training(pipeline.training, factor))


def _item(item: Item, factor: Fraction) -> Item:
    if not item.point.scheduled:
        return item
    host = item.host
    moved = {
        "start": _moment(host.start, factor),
        "stop": None if host.stop is None else _moment(host.stop, factor),
        "every": _moment(host.every, factor),
        "phase": int(host.phase * factor),
    }
    return replace(item, host=HostSettings.model_validate({**host.model_dump(), **moved}))


def _training(settings: TrainingSettings, factor: Fraction) -> TrainingSettings:
    steps = settings.learning_rates.position_steps
    rates = {
        **settings.learning_rates.model_dump(),
        "position_steps": None if steps is None else _moment(steps, factor),
    }
    moved = {
        "iterations": int(settings.iterations * factor),
        "sh_every": _moment(settings.sh_every, factor),
        "learning_rates": rates,
    }
    return TrainingSettings.model_validate({**settings.model_dump(), **moved})


def _moment(moment: int, factor: Fraction) -> int:
    """The first iteration stays the first, and what is due in each one stays due in each."""
    return max(1, int(moment * factor)) if moment > 1 else moment
