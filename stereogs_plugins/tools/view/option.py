"""The option `--view` of `train` and `resume`: the scene in the browser while it trains."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from registry import Register, TrainOption, hookimpl

from .verb import PORT

if TYPE_CHECKING:
    from registry.commands import TrainRequest
    from registry.runs import Run, RunOptions
    from registry.training import Iteration

    from .following import Following


class LivePage(TrainOption):
    """The option `--view`."""

    verbs = ("train", "resume")

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the option."""
        parser.add_argument(
            "--view",
            action="store_true",
            help="show the scene in the browser while it trains, and after that until Ctrl-C",
        )

    @contextmanager
    def running(self, request: TrainRequest, options: RunOptions) -> Iterator[RunOptions]:
        """Serve the page during training; keep the page of a finished run until Ctrl-C.

        Raises:
            RunError: the viewer package is missing; raised before anything is loaded.
        """
        if not request.arguments.view:
            yield options
            return
        from .package import import_viser

        import_viser()
        from registry.commands import console

        output = console()
        pages: list[Following] = []

        def begin(run: Run) -> None:
            from .following import Following

            page = Following(run, PORT)
            pages.append(page)
            output.print(f"{run.scene.name} is at {page.url} while it trains")

        def iterated(done: Iteration) -> None:
            pages[0].iterated(done)

        try:
            yield replace(options, on_begin=begin, callback=iterated)
            for page in pages:
                if page.run.finished:
                    output.print(f"{page.run.scene.name} stays at {page.url}; Ctrl-C ends it")
                    _stay(page)
        finally:
            for page in pages:
                page.close()


def _stay(page: Following) -> None:
    from registry.training import one_torch_thread

    with one_torch_thread():
        page.stay()


@hookimpl
def stereogs_register_train_options(register: Register[TrainOption]) -> None:
    register("view", LivePage)
