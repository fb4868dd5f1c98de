"""Who was at work when something failed: turn any exception of a component into a named error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from core_rasterizer.errors import ExplainedError

from ..errors import PluginError
from ..plugins import Offer
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

    An `ExplainedError` keeps its type, what and fix, and gains the component in its `where`; any
    other exception becomes a `PluginError` with the original as its cause. KeyboardInterrupt and
    the like pass unchanged.

    Args:
        item: the component at work.
        iteration: of training, or None outside the loop.
    """
    culprit = f"{item.offer} at {item.place}"
    if iteration is not None:
        culprit += f", iteration {iteration}"
    try:
        yield
    except ExplainedError as error:
        error.where = f"{error.where}; in {culprit}" if error.where else culprit
        raise
    except Exception as error:
        raise PluginError(
            f"the {item.offer.point.title} {item.offer.name!r} failed: "
            f"{type(error).__name__}: {error}",
            where=culprit,
            fix=f"report it to the authors of {item.offer.distribution}, or switch it off with "
            f"`--disable {item.offer.name}`; STEREOGS_TRACE=1 shows the whole traceback",
        ) from error
