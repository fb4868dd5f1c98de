"""The context of every call into a component: names it in errors, and checks what it leaves behind."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import TYPE_CHECKING, NamedTuple

from core_rasterizer.errors import ExplainedError

from ..calls.memory import LEDGER
from ..calls.process_state import left_as_found, no_global_random_numbers, own_random_numbers
from ..calls.read_only_guard import NOTHING, ReadOnlyGuard, are_checked
from ..calls.watchdog import WATCHDOG, Hang
from ..contract.prior import Prior
from ..errors import PluginError

if TYPE_CHECKING:
    from .pipeline import Item


@contextmanager
def blame(item: Item, iteration: int | None = None) -> Iterator[None]:
    """Name the component in every error that leaves the block.

    An `ExplainedError` keeps its type and text; the component is added to its `where`, and a fix if it has
    none. Any other exception, and an attempt to exit, becomes a `PluginError` with the original as its
    cause. Ctrl-C passes, with a note that names the component.

    Args:
        item: the component that is called.
        iteration: of training, or None outside the loop.
    """
    name = culprit = _name(item)
    if iteration is not None:
        culprit += f", iteration {iteration}"
    try:
        yield
    except ExplainedError as error:
        error.where = f"{error.where}; in {culprit}" if error.where else culprit
        error.fix = error.fix or _advice(item)
        raise
    except KeyboardInterrupt as stop:
        stop.add_note(f"while {culprit} was at work")
        raise
    except Hang as hang:
        if hang.call.who != name:
            raise  # another component hangs, which this one called or was called by
        raise hang.explained() from None
    except BaseException as error:  # SystemExit and panics of compiled libraries too
        raise PluginError(
            f"the {item.offer.point.title} {item.offer.name!r} failed: {_text(error)}",
            where=culprit,
            fix=f"{_advice(item)}; STEREOGS_TRACE=1 shows the whole traceback",
        ) from error


class _Call(NamedTuple):
    """The current call into a component; the calls that it makes itself, such as to priors, inherit it."""

    iteration: int | None = None
    lent: ReadOnlyGuard = NOTHING
    look: bool = True


_CALL: ContextVar[_Call] = ContextVar("call")


@contextmanager
def at_work(
    item: Item,
    seed: int,
    iteration: int | None = None,
    lent: ReadOnlyGuard = NOTHING,
    *,
    look: bool = True,
    every_bit: bool = False,
) -> Iterator[None]:
    """The context of a call into a component.

    Errors name it (`blame`), the watchdog and the memory ledger record it, and it must not change the
    tensors that it receives or the state of the process. Within an iteration it must not use global random
    generators; outside, they are seeded for the call and restored afterwards.

    Args:
        iteration: of training; None outside the loop, or for the iteration of the calling component.
        lent: tensors that it receives, besides those of the calling component.
        look: check the global generators within an iteration, which takes longer than most checks.
        every_bit: find writes that bypass torch, as in every call if plugins are checked.
    """
    outer = _CALL.get(_Call())
    if iteration is None:
        iteration, look = outer.iteration, look and outer.look
    call = _Call(iteration, outer.lent + lent, look)
    name = _name(item)
    random_numbers: AbstractContextManager[None] = nullcontext()
    if iteration is None:
        random_numbers = own_random_numbers(seed)
    elif look:
        random_numbers = no_global_random_numbers()
    token = _CALL.set(call)
    try:
        with (
            blame(item, iteration),
            WATCHDOG.watching(name, iteration),
            LEDGER.watching(name),
            left_as_found(name, threads=not item.point.observes),
            random_numbers,
            call.lent.kept(every_bit=every_bit or are_checked()),
        ):
            yield
    finally:
        _CALL.reset(token)


def _text(error: BaseException) -> str:
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:  # its __str__ fails
        return type(error).__name__


def _name(item: Item) -> str:
    return f"{item.offer} at {item.place}"


def _advice(item: Item) -> str:
    """How a user can work around a component that fails."""
    report = f"report it to the authors of {item.offer.distribution}"
    if item.point.required or issubclass(item.point.base, Prior):
        return f"{report}, or put another {item.point.title} in its place"
    return f"{report}, or switch it off with `--disable {item.offer.name}`"
