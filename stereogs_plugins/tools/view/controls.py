"""The panel beside the picture: what is shown, and what is left out."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from .picture import CHANNELS, Box, Look

Bounds = tuple[tuple[float, float, float], tuple[float, float, float]]


class Controls:
    """The switches of one page.

    Args:
        server: viser's.
        kinds: of Gaussians that can be switched on and off.
        bounds: the lowest and the highest corner of what the crop box can keep, world units.
        on_look: called when the picture must be drawn anew.
        on_cameras: called with whether they are to be seen.
    """

    def __init__(
        self,
        server: Any,
        *,
        kinds: Iterable[str],
        bounds: Bounds,
        on_look: Callable[[], None],
        on_cameras: Callable[[bool], None],
    ) -> None:
        gui = server.gui
        self.status = gui.add_markdown("")
        self._channel = gui.add_dropdown("Show", CHANNELS, initial_value=CHANNELS[0])
        self._on_change(self._channel, on_look)
        cameras = gui.add_checkbox("Cameras", True)
        self._on_change(cameras, lambda: on_cameras(cameras.value))
        self._ellipsoids = gui.add_checkbox("Ellipsoids", False)
        self._on_change(self._ellipsoids, on_look)
        self._kinds = {}
        kinds = tuple(kinds)
        if kinds:
            with gui.add_folder("Kinds of points"):
                self._kinds = {kind: gui.add_checkbox(kind, True) for kind in kinds}
        with gui.add_folder("Crop box", expand_by_default=False):
            self._cropped = gui.add_checkbox("Keep the inside alone", False)
            self._ranges = [
                gui.add_multi_slider(
                    axis, min=low, max=high, step=(high - low) / 200, initial_value=(low, high)
                )
                for axis, low, high in zip("xyz", *bounds, strict=True)
            ]
        for handle in (*self._kinds.values(), self._cropped, *self._ranges):
            self._on_change(handle, on_look)

    @property
    def ellipsoids(self) -> bool:
        """Whether ellipsoids stand in for the picture."""
        return bool(self._ellipsoids.value)

    @property
    def look(self) -> Look:
        """What is chosen now."""
        box = None
        if self._cropped.value:
            x, y, z = (slider.value for slider in self._ranges)
            box = Box((x[0], y[0], z[0]), (x[1], y[1], z[1]))
        hidden = tuple(kind for kind, switch in self._kinds.items() if not switch.value)
        return Look(self._channel.value, hidden, box)

    @staticmethod
    def _on_change(handle: Any, told: Callable[[], None]) -> None:
        handle.on_update(lambda _: told())
