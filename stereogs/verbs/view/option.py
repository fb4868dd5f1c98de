"""The option `--view` of `train` and `resume`: show the scene in the browser during training."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from ...command_line.command import TrainOption
from . import PORT, import_viser

if TYPE_CHECKING:
    from registry.runs.options import RunOptions
    from registry.runs.run import Run
    from registry.training.trainer import Iteration

    from ...command_line.command import TrainRequest
    from .live_page import LivePage


class LiveView(TrainOption):
    """The option `--view`."""

    verbs = ("train", "resume")

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "--view",
            action="store_true",
            help="show the scene in the browser during training, and afterwards until Ctrl-C",
        )

    @contextmanager
    def running(self, request: TrainRequest, options: RunOptions) -> Iterator[RunOptions]:
        """Serve the page during training; serve a finished run until Ctrl-C.

        Raises:
            RunError: viser is not installed; raised before a scene is loaded.
        """
        if not request.arguments.view:
            yield options
            return
        import_viser()
        from ...command_line.output import console

        output = console()
        pages: list[LivePage] = []

        def begin(run: Run) -> None:
            from .live_page import LivePage

            if options.on_begin is not None:
                options.on_begin(run)
            if pages:  # training started again
                pages[0].run = run
                return
            pages.append(LivePage(run, PORT))
            output.print(f"{run.scene.name} is at {pages[0].url} during training")

        def iterated(iteration: Iteration) -> bool | None:
            pages[0].update(iteration)
            return None if options.callback is None else options.callback(iteration)

        try:
            yield replace(options, on_begin=begin, callback=iterated)
            for page in pages:
                if page.run.finished:
                    output.print(
                        f"{page.run.scene.name} is still at {page.url} (press Ctrl-C to stop)"
                    )
                    page.serve_finished_run()
        finally:
            for page in pages:
                page.close()
