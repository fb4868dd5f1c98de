"""The loss of an iteration: the photometric term, and the terms of regularizers."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from core_rasterizer import Device, ExplainedError, Rendering, photometric_loss
from core_rasterizer.layout import PARAMETER_GROUPS

from ..calls.read_only_guard import ReadOnlyGuard
from ..contract.checks.answers import check_loss, check_moves
from ..contract.step import Step
from ..errors import RunError
from ..pipeline.parts import Part, Parts
from ..pipeline.training_settings import TrainingSettings
from .guard import Term

Log = Callable[[str, float], None]
"""Logs a number by name."""


def photometric_term(
    settings: TrainingSettings, shown: Tensor | Rendering, step: Step, device: Device, log: Log
) -> Term:
    """Return L1 and D-SSIM between colours, or a render, and the target of the iteration.

    Raises:
        RunError: the colours are not finite.
    """
    try:
        loss = photometric_loss(
            shown,
            step.sample.target,
            settings.ssim_weight,
            l1_weight=settings.l1_weight,
            device=device,
        )
    except ExplainedError as error:
        raise RunError(
            error.what,
            where=f"iteration {step.iteration}, view {step.view.name!r}",
            fix="lower the learning rates; the last checkpoint, if any, is intact",
        ) from error
    log("photometric", float(loss.detach()))
    return Term(None, loss)


def regularizing_terms(parts: Parts, step: Step, lent: ReadOnlyGuard, log: Log) -> list[Term]:
    """Return the terms that are due and part of the common loss.

    Args:
        lent: data that they receive.
    """
    return [
        _term(part, step, lent, log)
        for part in parts.due("regularizers", step.iteration)
        if part.item.host.step == "together"
    ]


def term_alone(
    part: Part, step: Step, lent: ReadOnlyGuard, log: Log
) -> tuple[Term, tuple[str, ...]]:
    """Return a term that is stepped alone.

    Args:
        lent: data that it receives.

    Returns:
        The term, and the parameter groups that its step does not change.
    """
    with part.at_work(step.iteration, lent):
        moves = check_moves(part.component.moves, PARAMETER_GROUPS)
    skip = () if moves is None else tuple(name for name in PARAMETER_GROUPS if name not in moves)
    return _term(part, step, lent, log), skip


def _term(part: Part, step: Step, lent: ReadOnlyGuard, log: Log) -> Term:
    """Return the term of a regularizer times its weight."""
    with part.at_work(step.iteration, lent):
        term = check_loss(part.component.loss(step))
    log(part.item.qualified_name, float(term.detach()))
    return Term(part.item, part.item.host.weight * term)
