"""Show a run in the browser during training.

Images are rendered between two iterations, from a copy of the Gaussians, so they cannot change the training.
"""

from __future__ import annotations

import logging
from time import monotonic
from typing import TYPE_CHECKING

from core_rasterizer import GaussianError
from registry.calls.process_state import one_torch_thread

from .subject import of_run, snapshot
from .viewer import Viewer

if TYPE_CHECKING:
    from registry.runs.run import Run
    from registry.training.trainer import Iteration

COPY_SECONDS = 1.0
"""Shortest time between two copies of the Gaussians."""
COPY_SHARE = 0.1
"""Largest share of the time for copies and their images while the camera does not move."""
MOVING_SHARE = 0.5
"""Largest share of the time for images while the camera moves."""

_log = logging.getLogger(__name__)


class LivePage:
    """The page of a run in training; costs nothing while nobody has it open.

    Raises:
        RunError: viser is not installed.
    """

    def __init__(self, run: Run, port: int) -> None:
        self.run = run
        self._viewer: Viewer | None = Viewer(snapshot(run), port)
        self.url = self._viewer.url
        self._next_copy = self._next_image = 0.0

    def update(self, iteration: Iteration) -> None:
        """Render for open pages if it is time; on an error, close the page and log a warning."""
        if self._viewer is None or not self._viewer.has_clients:
            return
        try:
            self._render(self._viewer, iteration)
        except Exception as error:
            _log.warning("the page is closed, training continues: %s", error)
            self.close()

    @one_torch_thread()
    def serve_finished_run(self) -> None:
        """Show the final Gaussians until Ctrl-C."""
        if self._viewer is None:
            return
        self._viewer.show(of_run(self.run), self.run.iteration)
        self._viewer.serve_until_interrupted()

    def close(self) -> None:
        """Stop the server."""
        viewer, self._viewer = self._viewer, None
        if viewer is not None:
            viewer.close()

    def _render(self, viewer: Viewer, iteration: Iteration) -> None:
        begin = monotonic()
        if begin >= self._next_copy:
            try:
                viewer.show(snapshot(self.run), iteration.number)
            except GaussianError:  # not finite; training will remove them
                self._next_copy = begin + COPY_SECONDS
                return
            viewer.serve_moved()
            end = monotonic()
            self._next_copy = begin + max(COPY_SECONDS, (end - begin) / COPY_SHARE)
        elif begin >= self._next_image and viewer.serve_moved():
            end = monotonic()
            self._next_image = end + (end - begin) * (1 / MOVING_SHARE - 1)
