"""--view: the page of a run in training."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from ..view import PORT

if TYPE_CHECKING:
    from rich.console import Console

    from ...runs.run import Run
    from ...training.trainer import Iteration
    from ...viewing.following import Following


@contextmanager
def live_page(wanted: bool, output: Console) -> Iterator[dict[str, Any]]:
    """Arguments of `stereogs.train` and `resume` that show the run in the browser; none if not wanted.

    At the end of the block the page of a finished run stays until Ctrl-C.

    Raises:
        RunError: the package that shows it is missing; told before anything is loaded.
    """
    if not wanted:
        yield {}
        return
    from ...viewing.package import import_viser

    import_viser()
    pages: list[Following] = []

    def begin(run: Run) -> None:
        from ...viewing.following import Following

        page = Following(run, PORT)
        pages.append(page)
        output.print(f"{run.scene.name} is at {page.url} while it trains")

    def iterated(done: Iteration) -> None:
        pages[0].iterated(done)

    try:
        yield {"on_begin": begin, "callback": iterated}
        for page in pages:
            if page.run.finished:
                output.print(f"{page.run.scene.name} stays at {page.url}; Ctrl-C ends it")
                _stay(page)
    finally:
        for page in pages:
            page.close()


def _stay(page: Following) -> None:
    from ...training.threads import one_torch_thread

    with one_torch_thread():
        page.stay()
