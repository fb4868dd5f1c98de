"""Name the component in errors that leave a call."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from core_rasterizer.errors import ExplainedError

from ..errors import PluginError
from ..system.memory import FREE_MEMORY, out_of_memory
from .watchdog import Hang

if TYPE_CHECKING:
    from ..contract.hook_points import HookPoint


class Callee(Protocol):
    """The component that is called, as messages name it: an item of a pipeline.

    Its text names the component, its package and its line in the pipeline.
    """

    @property
    def point(self) -> HookPoint:
        """The hook point of its section."""

    @property
    def kind(self) -> str:
        """Title and name, for example "metric 'psnr'"."""

    @property
    def advice(self) -> str:
        """How a user can work around it if it fails."""


class blame:
    """A context that names the component in every error that leaves the block.

    An `ExplainedError` keeps its type and text; the component is added to its `where`, and a fix if it has
    none. Any other exception, and an attempt to exit, becomes a `PluginError` with the original as its
    cause. Ctrl-C passes, with a note that names the component.

    The contexts of every call are classes: a generator would take several times as long.

    Args:
        iteration: of training, or None outside the loop.
    """

    __slots__ = ("_callee", "_iteration")

    def __init__(self, callee: Callee, iteration: int | None = None) -> None:
        self._callee, self._iteration = callee, iteration

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None:
            _name(self._callee, self._iteration, error)


def _name(callee: Callee, iteration: int | None, error: BaseException) -> None:
    """Add the component to an error, or raise one that names it instead."""
    culprit = _in_iteration(callee, iteration)
    if isinstance(error, ExplainedError):
        error.where = f"{error.where}; in {culprit}" if error.where else culprit
        error.fix = error.fix or callee.advice
    elif isinstance(error, KeyboardInterrupt):
        error.add_note(f"while {culprit} was at work")
    elif isinstance(error, Hang):
        if error.call.who == str(callee):  # else another hangs, which it called or was called by
            raise error.explained() from None
    elif out_of_memory(error):
        raise PluginError(
            f"memory ran out in the {callee.kind}: {_text(error)}", where=culprit, fix=FREE_MEMORY
        ) from error
    else:  # SystemExit and panics of compiled libraries too
        raise PluginError(
            f"the {callee.kind} failed: {_text(error)}",
            where=culprit,
            fix=f"{callee.advice}; STEREOGS_TRACE=1 shows the whole traceback",
        ) from error


def _in_iteration(callee: Callee, iteration: int | None) -> str:
    return str(callee) if iteration is None else f"{callee}, iteration {iteration}"


def _text(error: BaseException) -> str:
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:  # its __str__ fails
        return type(error).__name__
