"""Checks that only finite gradients reach the optimizer, and finds the component that made others.

They cost nothing without a failure: the loss is read anyway, and the engine checks the gradients of images
and parameters as it reads them. After a failure the loss is differentiated term by term.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor

from core_rasterizer import ExplainedError
from core_rasterizer.finite import undefined_places

from ..errors import PluginError, RunError
from ..pipeline.blame import Blamable, blame


@dataclass(frozen=True, eq=False)
class Term:
    """A term of the loss.

    Args:
        item: its regularizer; None for the photometric term.
        value: scalar with gradient, including the weight.
    """

    item: Blamable | None
    value: Tensor


@dataclass(frozen=True, eq=False)
class Recolored:
    """Colours between the render and the photometric term.

    Args:
        item: the appearance that computed `after` from `before`.
    """

    item: Blamable
    before: Tensor
    after: Tensor


def backward(
    terms: Sequence[Term],
    iteration: int,
    *,
    colors: Sequence[Recolored] = (),
    forget: Callable[[], None],
    check: Callable[[], None],
) -> float:
    """Run the backward pass, and return the loss.

    Args:
        terms: terms of the loss, in order of summation.
        colors: outputs of appearances, in order.
        forget: clears all gradients.
        check: checks the gradients of the components' parameters.

    Raises:
        ExplainedError: the loss or a gradient is not finite, or the backward pass of a component failed;
            names the component.
    """
    loss = terms[0].value
    for term in terms[1:]:
        loss = loss + term.value
    total = float(loss.detach())
    if not math.isfinite(total):
        _refuse_loss(terms, iteration)
    with in_iteration(iteration):
        try:
            loss.backward(retain_graph=True)
            check()
        except Exception:
            _take_apart(terms, colors, iteration, forget, check)
            raise
    return total


@contextmanager
def in_iteration(iteration: int) -> Iterator[None]:
    """Add the iteration to errors of the block that lack it."""
    try:
        yield
    except ExplainedError as error:
        if "iteration" not in error.where:
            place = f"iteration {iteration}"
            error.where = f"{error.where}; {place}" if error.where else place
        raise


def _refuse_loss(terms: Sequence[Term], iteration: int) -> None:
    """Name the first term that is not finite; each was finite before the weight."""
    what = "the loss is too large for single precision"
    fix = "lower the weight of the term, or its size"
    for term in terms:
        if term.item is not None and not math.isfinite(float(term.value.detach())):
            with blame(term.item, iteration):
                raise PluginError(f"{what}: this term times its weight is", fix=fix)
    raise RunError(what, where=f"iteration {iteration}", fix=fix)


def _take_apart(
    terms: Sequence[Term],
    colors: Sequence[Recolored],
    iteration: int,
    forget: Callable[[], None],
    check: Callable[[], None],
) -> None:
    """Differentiate the terms one by one; the first that fails raises with the name of its component."""
    for term in terms:
        if not term.value.requires_grad:
            continue
        forget()
        if term.item is not None:
            with blame(term.item, iteration):
                term.value.backward(retain_graph=True)
                check()
            continue
        for step in reversed(colors):
            with blame(step.item, iteration):
                _differentiate_colors(term.value, step)
        term.value.backward(retain_graph=True)
        check()


def _differentiate_colors(loss: Tensor, step: Recolored) -> None:
    (gradient,) = torch.autograd.grad(loss, step.before, retain_graph=True, allow_unused=True)
    if gradient is None:
        return
    undefined = undefined_places(gradient)
    if len(undefined):
        raise PluginError(
            f"the colours have an undefined gradient in {len(undefined)} values",
            where=f"pixel and channel {undefined[0].tolist()}",
            fix="look for a division by zero or a square root of zero",
        )
