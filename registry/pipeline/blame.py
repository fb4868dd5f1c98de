"""Around every call into a component: whose error it is, and what the call must leave as it was."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Protocol

from core_rasterizer.errors import ExplainedError

from ..calls.memory import LEDGER
from ..calls.process_state import left_as_found, no_global_random_numbers, own_random_numbers
from ..calls.read_only_guard import NOTHING, ReadOnlyGuard
from ..calls.watchdog import WATCHDOG, Hang
from ..contract.prior import Prior
from ..errors import PluginError
from ..plugins.discovery import Offer
from .yaml_source import Place


class Blamable(Protocol):
    """A component's origin: what a pipeline's item carries."""

    @property
    def offer(self) -> Offer: ...
    @property
    def place(self) -> Place: ...


@contextmanager
def blame(item: Blamable, iteration: int | None = None) -> Iterator[None]:
    """Name the component in every error that leaves the block.

    An `ExplainedError` keeps its type and what, gains the component in its `where`, and a fix if it
    has none; any other exception, and an attempt to exit, becomes a `PluginError` with the original as
    its cause. Ctrl-C passes, with a note of who was at work.

    Args:
        item: the component at work.
        iteration: of training, or None outside the loop.
    """
    culprit = _culprit(item)
    if iteration is not None:
        culprit += f", iteration {iteration}"
    try:
        yield
    except ExplainedError as error:
        error.where = f"{error.where}; in {culprit}" if error.where else culprit
        error.fix = error.fix or _advice(item)
        raise
    except (Exception, SystemExit) as error:
        raise PluginError(
            f"the {item.offer.point.title} {item.offer.name!r} failed: "
            f"{type(error).__name__}: {error}",
            where=culprit,
            fix=f"{_advice(item)}; STEREOGS_TRACE=1 shows the whole traceback",
        ) from error
    except KeyboardInterrupt as stop:
        stop.add_note(f"while {culprit} was at work")
        raise
    except Hang as hang:
        if hang.call.who != _culprit(item):
            raise  # not this one, but who asked it
        raise hang.explained() from None


@dataclass(frozen=True)
class _Asked:
    """What a component's call hands on to those that it asks itself, such as priors."""

    iteration: int | None = None
    lent: ReadOnlyGuard = NOTHING
    look: bool = True


_NOBODY = _Asked()
_ASKED: ContextVar[_Asked] = ContextVar("asked")


@contextmanager
def at_work(
    item: Blamable,
    seed: int,
    iteration: int | None = None,
    lent: ReadOnlyGuard = NOTHING,
    *,
    look: bool = True,
) -> Iterator[None]:
    """Everything that is done around a call into a component.

    Errors name it (`blame`), the watchdog knows of it, its memory is counted, and it must leave what it
    is lent and what the process shares as they are. Within an iteration it may not touch global random
    generators; else it has them to itself.

    Args:
        item: the component at work.
        seed: for the global generators.
        iteration: of training; None outside the loop, or for that of the component that asks.
        lent: what it is shown, beside what the component that asks was.
        look: whether to look at the global generators within an iteration, which takes longer than all
            the rest.
    """
    asked = _ASKED.get(_NOBODY)
    if iteration is None:
        iteration, look = asked.iteration, look and asked.look
    inner = _Asked(iteration, asked.lent + lent, look)
    who = _culprit(item)
    token = _ASKED.set(inner)
    try:
        with (
            blame(item, iteration),
            WATCHDOG.watching(who, iteration),
            LEDGER.watching(who),
            left_as_found(who, threads=not item.offer.point.observes),
            _random_numbers(seed, inner),
            inner.lent.kept(),
        ):
            yield
    finally:
        _ASKED.reset(token)


def _random_numbers(seed: int, asked: _Asked) -> AbstractContextManager[None]:
    if asked.iteration is None:
        return own_random_numbers(seed)
    return no_global_random_numbers() if asked.look else nullcontext()


def _culprit(item: Blamable) -> str:
    return f"{item.offer} at {item.place}"


def _advice(item: Blamable) -> str:
    """What a user can do about a component that fails."""
    point, package = item.offer.point, item.offer.distribution
    if point.required or issubclass(point.base, Prior):
        return f"report it to the authors of {package}, or put another {point.title} in its place"
    return f"report it to the authors of {package}, or switch it off with `--disable {item.offer.name}`"
