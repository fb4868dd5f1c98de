"""A short training run of a component in the host's own loop: repeated, and stopped after each iteration."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from core_rasterizer import Gaussians

from ..contract.component import Component, Settings
from ..pipeline.parts import Parts
from ..pipeline.training_settings import TrainingSettings
from ..training.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from ..training.initial_model import new_model
from ..training.trainer import Trainer
from .bench import Bench
from .carrying import check_carry
from .companions import UNDER_TEST, RandomEdits, item, pipeline_of
from .judging import first_difference, require
from .watching import by_itself, untouched

TRAINING = TrainingSettings(iterations=12, sh_degree=1, sh_every=5)
"""Each kind of edit of `RandomEdits` once; none in the last iteration."""


def rehearse(component: type[Component[Any]], settings: Settings, bench: Bench) -> None:
    """Train with the component while Gaussians come and go, twice.

    The second time everything is saved to a file after each iteration and read back into new objects,
    which must give the same bits.

    Raises:
        AssertionError: they are others; the component changed the scene, a global random state or a
            switch of the process; or it does not follow a change of topology (`check_carry`).
        ExplainedError: the host refuses an answer, or the component failed.
    """
    with untouched({"scene": bench.scene}), by_itself():
        trainer = _trainer(component, settings, bench)
        states = _states(trainer)
        difference = _resumed_difference(component, settings, bench, states)
        if difference is not None:
            again = _states(_trainer(component, settings, bench))
            same_again = all(
                first_difference(*both) is None for both in zip(states, again, strict=True)
            )
            require(same_again, "two runs with one seed gave different answers")
            raise AssertionError(
                f"{difference}; does state() hand out, and restore() take back, all that the next "
                "answers depend on?"
            )
        (part,) = (part for part in trainer.parts if part.item.name == UNDER_TEST)
        check_carry(part.component, trainer.model.count)


def _states(trainer: Trainer) -> list[dict[str, Tensor]]:
    """Everything that a run depends on, after each of its iterations."""
    return [_copied(trainer.state()) for _ in trainer.run()]


def _resumed_difference(
    component: type[Component[Any]],
    settings: Settings,
    bench: Bench,
    expected: list[dict[str, Tensor]],
) -> str | None:
    """In what a run that is stopped and resumed after every iteration first differs; None if it does not."""
    trainer = _trainer(component, settings, bench)
    with tempfile.TemporaryDirectory() as folder:
        for iteration, state in enumerate(expected, 1):
            next(trainer.run())
            name = first_difference(state, trainer.state())
            if name is not None:
                return (
                    f"a run that was resumed after iteration {iteration - 1} differs after the next "
                    f"from one that was not, first in {name}"
                )
            save_checkpoint(Checkpoint(iteration, 0.0, trainer.state(), ""), Path(folder))
            saved = load_checkpoint(Path(folder))
            trainer = _trainer(component, settings, bench, saved.part)
            trainer.restore(iteration, saved.part)
    return None


def _trainer(
    component: type[Component[Any]],
    settings: Settings,
    bench: Bench,
    part: Callable[[str], Mapping[str, Tensor]] | None = None,
) -> Trainer:
    """The host's loop around a new component; at the Gaussians of a checkpoint if one is given."""
    items = [
        item(component, settings, UNDER_TEST),
        item(RandomEdits, RandomEdits.Settings(), "random_edits"),
        *(item(type(prior), prior.settings, name) for name, prior in bench.priors.items()),
    ]
    training = TRAINING.model_copy(update={"fields": component.needs_fields})
    parts = Parts(pipeline_of(items, training), bench.device)
    model = bench.model()
    if part is not None:
        model = new_model(Gaussians(**part("model")), training, bench.device)
    return Trainer(training, parts, bench.scene, model, bench.maps(), bench.kinds())


def _copied(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name: values.clone() for name, values in state.items()}
