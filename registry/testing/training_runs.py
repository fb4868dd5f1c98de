"""Short training runs with a component, stopped and resumed."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..calls.repeats import first_difference
from ..contract.component import Component, Settings
from ..discovery import Plugins
from ..pipeline.parts import Parts
from ..pipeline.pipeline import Pipeline
from ..pipeline.training_settings import TrainingSettings
from ..runs.options import RunOptions
from ..runs.training_run import continue_run, start_run
from ..training.assembly import restore
from ..training.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from ..training.trainer import Trainer
from .assertions import no_side_effects, require
from .bench import Bench
from .scenes import UNDER_TEST, RandomEdits, pipeline_item, pipeline_of

_TRAINING = TrainingSettings(iterations=12, sh_degree=1, sh_every=5)
"""Applies each kind of edit of `RandomEdits` once, none in the last iteration."""
_OBSERVED = TrainingSettings(iterations=4, sh_degree=0, evaluate_every=2)

_TOPOLOGY_CHANGES: dict[str, Callable[[Tensor], tuple[Tensor, slice]]] = {
    "cloned": lambda old: (torch.cat([old, old[1::3]]), slice(len(old), None)),
    "pruned and cloned": lambda old: (torch.cat([old[2:], old[-2:]]), slice(-2, None)),
    "relocated": lambda old: (torch.cat([old[-1:], old[1:]]), slice(0, 1)),
    "pruned": lambda old: (old[1::2], slice(0, 0)),
}
"""From the old Gaussians' indices: `source` as for `Component.carry`, and which new ones are `fresh`."""


def train_and_resume(component: type[Component[Any]], settings: Settings, bench: Bench) -> None:
    """Train with the component and edits of the Gaussians, twice; the bits must be equal.

    The second run is saved to a file after each iteration and read back into new objects.

    Raises:
        AssertionError: the runs differ; the component changed the scene; or its state does not follow a
            change of topology (`_check_carry`).
        ExplainedError: the host refuses an answer, the component failed, or it changed state that the
            process shares.
    """
    with no_side_effects({"scene": bench.scene}):
        trainer = _trainer(component, settings, bench)
        states = _states(trainer)
        difference = _difference_when_resumed(component, settings, bench, states)
        if difference is not None:
            again = _states(_trainer(component, settings, bench))
            require(
                first_difference(states, again) is None,
                "two runs with one seed gave different answers",
            )
            raise AssertionError(
                f"{difference}; does state() return, and restore() take back, everything that the "
                "next answers depend on?"
            )
        (part,) = (part for part in trainer.parts if part.item.name == UNDER_TEST)
        _check_carry(part.component, trainer.model.count)


def _states(trainer: Trainer) -> list[dict[str, Tensor]]:
    """Train, and return the complete state after each iteration."""
    return [{k: value.clone() for k, value in trainer.state().items()} for _ in trainer.run()]


def _difference_when_resumed(
    component: type[Component[Any]],
    settings: Settings,
    bench: Bench,
    expected: list[dict[str, Tensor]],
) -> str | None:
    """Resume a run after every iteration; describe its first difference from the expected states."""
    trainer = _trainer(component, settings, bench)
    with tempfile.TemporaryDirectory() as folder:
        for iteration, state in enumerate(expected, 1):
            next(trainer.run())
            name = first_difference(state, trainer.state())
            if name is not None:
                return (
                    f"a run that was resumed after iteration {iteration - 1} differs in the next "
                    f"iteration from one that was not, first in {name}"
                )
            save_checkpoint(Checkpoint(iteration, 0.0, trainer.state(), ""), Path(folder))
            saved = load_checkpoint(Path(folder))
            trainer = _trainer(component, settings, bench, saved)
    return None


def _trainer(
    component: type[Component[Any]],
    settings: Settings,
    bench: Bench,
    saved: Checkpoint | None = None,
) -> Trainer:
    """Return a training loop with a new component, restored from a checkpoint if one is given."""
    items = [
        pipeline_item(component, settings, UNDER_TEST),
        pipeline_item(RandomEdits, RandomEdits.Settings(), "random_edits"),
        *(pipeline_item(type(p), p.settings, name) for name, p in bench.priors.items()),
    ]
    fields = 2 if "other_fields" in component.needs_rendered(settings) else 1
    training = _TRAINING.model_copy(update={"fields": fields})
    parts = Parts(pipeline_of(items, training), bench.device)
    if saved is not None:
        return restore(parts, bench.scene, saved)
    return Trainer(training, parts, bench.scene, bench.model(), bench.maps(), bench.kinds())


def _check_carry(component: Component[Any], count: int) -> None:
    """Check that a component's per-Gaussian state follows changes of topology.

    A tensor of `state()` with as many rows as there are Gaussians is taken for per-Gaussian state.

    Args:
        count: number of Gaussians that the component saw last.

    Raises:
        AssertionError: a tensor has the wrong number of rows afterwards, or a Gaussian has another's row.
    """
    for kind, change in _TOPOLOGY_CHANGES.items():
        before = {k: v.clone() for k, v in component.state().items() if v.ndim and len(v) == count}
        source, new = change(torch.arange(count))
        fresh = torch.zeros(len(source), dtype=torch.bool)
        fresh[new] = True
        component.carry(source, fresh)
        after = component.state()
        for name, values in before.items():
            if name in after:
                _check_rows(kind, name, values, after[name], source, fresh)
        count = len(source)


def _check_rows(
    kind: str, name: str, before: Tensor, after: Tensor, source: Tensor, fresh: Tensor
) -> None:
    """Accept empty tensors and equal rows: a component may reset its state."""
    if not len(after) or bool((after == after[:1]).all()):
        return
    require(
        len(after) == len(source),
        f"state()[{name!r}] has {len(after)} rows after Gaussians were {kind}, expected "
        f"{len(source)}; carry(source, fresh) must follow",
    )
    # A Gaussian that was copied may share a value with its copies; the others keep their rows.
    alone = ~fresh & (torch.bincount(source, minlength=len(before))[source] == 1)
    wrong = alone & (after != before[source]).reshape(len(source), -1).any(dim=1)
    require(
        not wrong.any(),
        f"state()[{name!r}] has another Gaussian's row at {int(wrong.int().argmax())} after "
        f"Gaussians were {kind}; new Gaussian i comes from old Gaussian source[i]",
    )


def observe_and_resume(component: type[Component[Any]], settings: Settings, bench: Bench) -> None:
    """Observe a run that is stopped half-way and resumed.

    Raises:
        AssertionError: its result differs from that of a run without the observer.
        ExplainedError: the host refuses an action of the observer, or it failed.
    """
    pipeline = pipeline_of([pipeline_item(component, settings, UNDER_TEST)], _OBSERVED)
    options = RunOptions(scene=bench.scene, device=bench.device, progress=False)
    expected = start_run(pipeline_of([], _OBSERVED), options)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "run"
        half = _OBSERVED.iterations // 2
        start_run(pipeline, replace(options, callback=lambda done: done.number < half), folder)
        run = continue_run(folder, options, _PipelinePlugins(pipeline))
    require(run.hash == expected.hash, "the run with the observer ends in other bits than without")


class _PipelinePlugins(Plugins):
    """The components of one pipeline, which need not be installed."""

    def __init__(self, pipeline: Pipeline) -> None:
        super().__init__(())
        self._offers = [item.offer for item in pipeline]
