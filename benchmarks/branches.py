"""Trainings with the same first iterations: one runs completely, the others continue from its checkpoint.

A regularizer has no effect before its start, so runs that differ in late regularizers only have equal bits
until the first of them starts. A branch ends with the same bits as a complete run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from time import monotonic, process_time

from registry import RunError
from registry.pipeline.parts import Parts
from registry.pipeline.pipeline import Item, Pipeline
from registry.runs.run import Run
from registry.system.memory import peak_memory_mb
from registry.training.assembly import restore
from registry.training.checkpoint import Checkpoint
from registry.training.trainer import Iteration, one_torch_thread
from stereogs.session import train

SECONDS = "_seconds"
"""Suffix of the times that components log."""


@dataclass
class Trained:
    """A training that has reached its end.

    Args:
        run: Run without a folder.
        cpu_seconds: CPU seconds of loading, initialization and training, over all threads; shared
            iterations count in full.
        peak_memory_mb: Peak memory of the process until then; known for the first training only.
        logged: Values that components logged in the last iteration; times are summed over all iterations.
    """

    run: Run
    cpu_seconds: float
    peak_memory_mb: int | None = None
    logged: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class _Moment:
    """The state at which the runs diverge."""

    checkpoint: Checkpoint
    cpu_seconds: float
    logged: dict[str, float]


def train_branches(pipelines: Sequence[Pipeline], device: str | None) -> Iterator[Trained]:
    """Train pipelines that differ only in priors and in regularizers with a late start.

    Args:
        pipelines: Pipelines, the first of which is trained completely; differing priors must be used by those
            regularizers only.
        device: Part of the device's name, or None.

    Raises:
        RunError: they differ otherwise, or a training was stopped.
        ExplainedError: any other failure of a training.
    """
    first, *others = pipelines
    shared = shared_iterations(pipelines)
    begin = process_time()
    moments: list[_Moment] = []
    logged: dict[str, float] = {}
    begun: list[Run] = []

    def follow(done: Iteration) -> None:
        _add(logged, done)
        if others and done.number == shared:
            moments.append(_Moment(_kept(begun[0]), process_time() - begin, dict(logged)))

    run = train(first, device=device, on_begin=begun.append, callback=follow)
    cpu_seconds, memory = process_time() - begin, peak_memory_mb()
    if not run.finished:
        raise RunError("the training was stopped", where=first.name)
    yield Trained(run, cpu_seconds, None if memory is None else round(memory), logged)
    for pipeline in others:
        yield _branch(pipeline, run, moments[0])


def _kept(run: Run) -> Checkpoint:
    """A checkpoint with copies of the tensors, as the run continues to train."""
    checkpoint = run.checkpoint()
    return replace(checkpoint, tensors={k: v.clone() for k, v in checkpoint.tensors.items()})


def shared_iterations(pipelines: Sequence[Pipeline]) -> int:
    """Return the number of iterations that the first of some pipelines shares with the others.

    Raises:
        RunError: they do not share any.
    """
    first, *others = pipelines
    apart = [item for other in others for item in _differences(first, other)]
    terms = [item for item in apart if item.point.section == "regularizers"]
    early = [item for item in apart if item.point.section not in ("regularizers", "priors")]
    alike = all(other.training == first.training for other in others)
    shared = min((item.schedule.start for item in terms), default=first.training.iterations) - 1
    if early or not alike or (others and shared < 1):
        raise RunError(
            "these pipelines do not share their first iterations: "
            + (
                ", ".join(item.qualified_name for item in early)
                or "regularizers start at once, or lengths differ"
            ),
            where=first.name,
            fix="train them one by one",
        )
    return shared


def _differences(one: Pipeline, other: Pipeline) -> list[Item]:
    """Items that only one of the pipelines has, or that have different settings."""
    return [item for item in one if item not in tuple(other)] + [
        item for item in other if item not in tuple(one)
    ]


@one_torch_thread()
def _branch(pipeline: Pipeline, trunk: Run, moment: _Moment) -> Trained:
    begin, cpu_begin = monotonic(), process_time()
    kept, device = moment.checkpoint, trunk.model.engine.device
    parts = Parts(pipeline, device)
    apart = _differences(pipeline, trunk.pipeline)
    new = tuple(f"components/{item.qualified_name}/" for item in apart)
    first = parts.for_field(0)
    for part in first.training:
        part.component.begin_training(trunk.scene.for_training())
    state = {f"components/{name}": value for name, value in first.state(0).items()}
    fresh = {name: value for name, value in state.items() if name.startswith(new)}
    trainer = restore(parts, trunk.scene, replace(kept, tensors=kept.tensors | fresh))
    logged = dict(moment.logged)
    for done in trainer.run():
        _add(logged, done)
    run = Run(
        pipeline,
        parts,
        trunk.scene,
        trainer.model,
        checkpoint=lambda: replace(kept, iteration=trainer.iteration, tensors=trainer.state()),
        iteration=trainer.iteration,
        initialization=trunk.initialization,
        seconds=replace(trunk.seconds, training=kept.seconds + monotonic() - begin),
    )
    return Trained(run, moment.cpu_seconds + process_time() - cpu_begin, logged=logged)


def _add(logged: dict[str, float], done: Iteration) -> None:
    """Replace the values by those of an iteration; add up seconds."""
    for name, value in done.logged.items():
        before = logged.get(name, 0.0) if name.endswith(SECONDS) else 0.0
        logged[name] = before + value
