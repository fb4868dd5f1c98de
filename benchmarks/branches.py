"""Trainings that begin alike: the first of them is trained whole, the others go on from where they part.

A term that is not due yet leaves no trace, so that runs that differ in such terms alone have equal bits until
the first is due. What a branch ends in are the bits of the whole run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from time import monotonic, process_time

from core_rasterizer import Gaussians
from registry import RunError
from registry.pipeline import Item, Parts, Pipeline
from registry.runs import Run
from registry.session import train
from registry.system import peak_memory_mb
from registry.training import Iteration, Trainer, new_model, one_torch_thread
from registry.training.checkpoint import Checkpoint
from registry.training.trainer import maps_of

SECONDS = "_seconds"
"""How what components log of their own time ends."""


@dataclass
class Trained:
    """A training that has reached its end.

    Args:
        run: without a folder.
        cpu_seconds: of loading, initialization and training, over all threads; what it shares with others
            counts in full.
        peak_memory_mb: the most that the process took until then; of the first training alone.
        logged: what components logged in the last iteration; their seconds over all iterations instead.
    """

    run: Run
    cpu_seconds: float
    peak_memory_mb: int | None = None
    logged: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class _Moment:
    """Where the runs part."""

    checkpoint: Checkpoint
    cpu_seconds: float
    logged: dict[str, float]


def train_branches(pipelines: Sequence[Pipeline], device: str | None) -> Iterator[Trained]:
    """Train pipelines that differ in priors and in regularizers that are not due at first.

    Args:
        pipelines: the first one is trained whole; priors that differ must be asked by those regularizers
            alone.
        device: part of its name; None chooses.

    Raises:
        RunError: they differ otherwise, or a training was stopped.
        ExplainedError: whatever goes wrong in one.
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
    """Where a run stands, for good: it trains on."""
    checkpoint = run.checkpoint()
    return replace(checkpoint, tensors={k: v.clone() for k, v in checkpoint.tensors.items()})


def shared_iterations(pipelines: Sequence[Pipeline]) -> int:
    """After how many iterations the first of some pipelines parts from the others.

    Raises:
        RunError: they are never alike.
    """
    first, *others = pipelines
    apart = [item for other in others for item in _differences(first, other)]
    terms = [item for item in apart if item.point.section == "regularizers"]
    early = [item for item in apart if item.point.section not in ("regularizers", "priors")]
    alike = all(other.training == first.training for other in others)
    shared = min((item.schedule.start for item in terms), default=first.training.iterations) - 1
    if early or not alike or (others and shared < 1):
        raise RunError(
            "these pipelines do not begin alike: "
            + (
                ", ".join(item.qualified_name for item in early)
                or "terms are due at once, or lengths differ"
            ),
            where=first.name,
            fix="train them one by one",
        )
    return shared


def _differences(one: Pipeline, other: Pipeline) -> list[Item]:
    """What either has and the other has not, or has with other settings."""
    return [item for item in one if item not in tuple(other)] + [
        item for item in other if item not in tuple(one)
    ]


@one_torch_thread()
def _branch(pipeline: Pipeline, trunk: Run, moment: _Moment) -> Trained:
    begin, cpu_begin = monotonic(), process_time()
    kept, device = moment.checkpoint, trunk.model.device
    parts = Parts(pipeline, device)
    model = new_model(Gaussians(**kept.part("model")), pipeline.training, device)
    trainer = Trainer(
        pipeline.training, parts, trunk.scene, model, maps_of(kept.part("maps")), kept.part("kinds")
    )
    apart = _differences(pipeline, trunk.pipeline)
    new = tuple(f"components/{item.qualified_name}/" for item in apart)
    fresh = {name: value for name, value in trainer.state().items() if name.startswith(new)}
    trainer.restore(kept.iteration, replace(kept, tensors=kept.tensors | fresh).part)
    logged = dict(moment.logged)
    for done in trainer.run():
        _add(logged, done)
    run = Run(
        pipeline,
        parts,
        trunk.scene,
        model,
        checkpoint=lambda: replace(kept, iteration=trainer.iteration, tensors=trainer.state()),
        iteration=trainer.iteration,
        initialization=trunk.initialization,
        seconds=replace(trunk.seconds, training=kept.seconds + monotonic() - begin),
    )
    return Trained(run, moment.cpu_seconds + process_time() - cpu_begin, logged=logged)


def _add(logged: dict[str, float], done: Iteration) -> None:
    """Take an iteration's numbers in the place of those before; of seconds the sum."""
    for name, value in done.logged.items():
        before = logged.get(name, 0.0) if name.endswith(SECONDS) else 0.0
        logged[name] = before + value
