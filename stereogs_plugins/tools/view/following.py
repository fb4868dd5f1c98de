"""A run in the browser while it is trained.

Drawing happens between two iterations, from a copy of the Gaussians, so it cannot change what is learnt.
"""

from __future__ import annotations

import logging
from time import monotonic
from typing import TYPE_CHECKING

from core_rasterizer import GaussianError

from .subject import of_run, snapshot
from .viewer import Viewer

if TYPE_CHECKING:
    from registry.runs import Run
    from registry.training import Iteration

RENEW_SECONDS = 1.0
"""Between two copies of the Gaussians."""
RENEWING_SHARE = 0.1
"""Of the time, that copies and their pictures may take while nobody moves."""
MOVING_SHARE = 0.5
"""Of the time, that pictures may take while a visitor moves."""

_log = logging.getLogger(__name__)


class Following:
    """The page of a run in training; without a visitor it costs nothing.

    Args:
        run: before its next iteration; from its own copy of it the page is drawn.
        port: see `Viewer`.

    Raises:
        RunError: viser is not installed.
    """

    def __init__(self, run: Run, port: int) -> None:
        self.run = run
        self._viewer: Viewer | None = Viewer(snapshot(run), port)
        self.url = self._viewer.url
        self._renewal_due = self._picture_due = 0.0

    def iterated(self, done: Iteration) -> None:
        """Draw what visitors are due. A page that fails is closed with a warning: training goes on."""
        if self._viewer is None or not self._viewer.is_visited:
            return
        try:
            self._draw(self._viewer, done)
        except Exception as error:
            _log.warning("the page is closed, training goes on: %s", error)
            self.close()

    def stay(self) -> None:
        """Show the run as it stands, until Ctrl-C."""
        if self._viewer is None:
            return
        self._viewer.show(of_run(self.run), self.run.iteration)
        self._viewer.serve_until_interrupted()

    def close(self) -> None:
        """End the server."""
        viewer, self._viewer = self._viewer, None
        if viewer is not None:
            viewer.close()

    def _draw(self, viewer: Viewer, done: Iteration) -> None:
        begin = monotonic()
        if begin >= self._renewal_due:
            try:
                viewer.show(snapshot(self.run), done.number)
            except GaussianError:  # training will remove the ones that are not finite
                self._renewal_due = begin + RENEW_SECONDS
                return
            viewer.serve_moved()
            end = monotonic()
            self._renewal_due = begin + max(RENEW_SECONDS, (end - begin) / RENEWING_SHARE)
        elif begin >= self._picture_due and viewer.serve_moved():
            end = monotonic()
            self._picture_due = end + (end - begin) * (1 / MOVING_SHARE - 1)
