"""Name the component in errors that leave a call."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
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


@contextmanager
def blame(callee: Callee, iteration: int | None = None) -> Iterator[None]:
    """Name the component in every error that leaves the block.

    An `ExplainedError` keeps its type and text; the component is added to its `where`, and a fix if it has
    none. Any other exception, and an attempt to exit, becomes a `PluginError` with the original as its
    cause. Ctrl-C passes, with a note that names the component.

    Args:
        iteration: of training, or None outside the loop.
    """
    try:
        yield
    except ExplainedError as error:
        culprit = _in_iteration(callee, iteration)
        error.where = f"{error.where}; in {culprit}" if error.where else culprit
        error.fix = error.fix or callee.advice
        raise
    except KeyboardInterrupt as stop:
        stop.add_note(f"while {_in_iteration(callee, iteration)} was at work")
        raise
    except Hang as hang:
        if hang.call.who != str(callee):
            raise  # another component hangs, which this one called or was called by
        raise hang.explained() from None
    except BaseException as error:  # SystemExit and panics of compiled libraries too
        if out_of_memory(error):
            raise PluginError(
                f"memory ran out in the {callee.kind}: {_text(error)}",
                where=_in_iteration(callee, iteration),
                fix=FREE_MEMORY,
            ) from error
        raise PluginError(
            f"the {callee.kind} failed: {_text(error)}",
            where=_in_iteration(callee, iteration),
            fix=f"{callee.advice}; STEREOGS_TRACE=1 shows the whole traceback",
        ) from error


def _in_iteration(callee: Callee, iteration: int | None) -> str:
    return str(callee) if iteration is None else f"{callee}, iteration {iteration}"


def _text(error: BaseException) -> str:
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:  # its __str__ fails
        return type(error).__name__
