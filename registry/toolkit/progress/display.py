"""Stages on a console: a bar on a terminal, else a line for each stage and one every ten seconds."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from .stages import STAGES, Stage, progress

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

_SECONDS_BETWEEN_LINES = 10.0
_BAR, _NAME = 20, 9
"""Width of the bar, and of the name before it."""
_DRAWN_PER_SECOND = 4


class StageDisplay:
    """Shows stages on a console: a bar in the last line of a terminal, else lines.

    Attributes:
        has_bar: whether there is a terminal; other text must then be printed on `console`.
    """

    def __init__(self, console: Console) -> None:
        from rich.live import Live

        self.console = console
        self.has_bar = console.is_terminal and not console.quiet
        self._printed = 0.0
        self._live = Live(
            get_renderable=self.bar,
            console=console,
            transient=True,
            refresh_per_second=_DRAWN_PER_SECOND,
            redirect_stderr=sys.stderr.isatty(),
        )

    def __enter__(self) -> None:
        if self.has_bar:
            self._live.start()

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def begun(self, stage: Stage) -> None:
        """Draw the bar at once, so that a short stage is seen too; without a bar print a line."""
        if self.has_bar:
            self._live.refresh()
        else:
            self._print(stage, f"{stage.done}/{stage.total}" if stage.total else "")

    def reached(self, stage: Stage) -> None:
        """Print a line every ten seconds if there is no bar."""
        if not self.has_bar and stage.latest - self._printed >= _SECONDS_BETWEEN_LINES:
            self._print(stage, stage.text(stage.latest, running=True))

    def ended(self, stage: Stage) -> None:
        """Print how long it took in place of the bar; without a bar only where there is a detail."""
        if self.has_bar or stage.detail():
            self._print(stage, stage.text(STAGES.clock(), running=False))

    def _print(self, stage: Stage, text: str) -> None:
        self._printed = STAGES.clock()
        self.console.print(f"{stage.name:<{_NAME}} {text}".rstrip())

    def bar(self) -> Text:
        """Return the bar, at most as wide as the terminal."""
        from rich.text import Text

        stage = STAGES.current
        if stage is None:
            return Text("")
        line = Text(f"{stage.name:<{_NAME}} ", no_wrap=True, overflow="crop")
        if stage.total:
            full, empty = "#-" if self.console.options.ascii_only else "━─"
            filled = _BAR * min(stage.done, stage.total) // stage.total
            line.append(full * filled, "green").append(
                empty * (_BAR - filled) + " ", "bright_black"
            )
        line.append(stage.text(STAGES.clock(), running=True))
        line.truncate(self.console.width - 1)
        return line


@contextmanager
def showing(console: Console) -> Iterator[None]:
    """Show the stages within the block on a console; a bar at once, for "reading". End the last after it.

    Within another such block for the same console only end the stage.
    """
    if any(display.console is console for display in _shown()):
        yield
        STAGES.begin(None)
        return
    outer, STAGES.current = STAGES.current, None
    display = StageDisplay(console)
    with display:
        STAGES.displays.append(display)
        try:
            if display.has_bar:
                progress("reading")
            yield
            STAGES.begin(None)
        finally:
            STAGES.displays.remove(display)
            STAGES.current = outer


def console_of_bar() -> Console | None:
    """Return the console of the bar on the terminal, if one is shown."""
    return next((display.console for display in _shown() if display.has_bar), None)


def _shown() -> Iterator[StageDisplay]:
    return (display for display in STAGES.displays if isinstance(display, StageDisplay))
