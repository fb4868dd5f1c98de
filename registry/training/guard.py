"""The guard of each iteration: nothing that is not a number reaches the optimizer, and who made it is named.

It costs nothing while all is well: the loss is a number that is read anyway, and the engine looks at the
gradients of images and parameters as it takes them. Only after a failure is the loss taken apart, term by
term, to find whose gradient it was.
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
    """A summand of the loss.

    Args:
        item: the regularizer that it comes from; None for the photometric term.
        value: a scalar in autograd, the weight included.
    """

    item: Blamable | None
    value: Tensor


@dataclass(frozen=True, eq=False)
class Recolored:
    """Colours on their way from the render to the photometric term.

    Args:
        item: the appearance that made `after` from `before`.
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
    """The backward pass of a loss.

    Args:
        terms: what the loss is the sum of, in this order.
        colors: what appearances made of the render, in their order.
        forget: makes all gradients zero.
        check: refuses gradients that only their owner knows.

    Returns:
        The loss.

    Raises:
        ExplainedError: the loss, or a gradient, is not finite, or a component's own backward pass failed;
            names the component whose term it was.
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
    """Say in errors of the block which iteration it was, where they do not yet."""
    try:
        yield
    except ExplainedError as error:
        if "iteration" not in error.where:
            place = f"iteration {iteration}"
            error.where = f"{error.where}; {place}" if error.where else place
        raise


def _refuse_loss(terms: Sequence[Term], iteration: int) -> None:
    """Each term was finite before it was weighed: name the first that no longer is."""
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
    """Differentiate the terms one by one; the first that fails alone raises, with its component's name."""
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
