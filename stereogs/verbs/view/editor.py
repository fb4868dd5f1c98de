"""Edit Gaussians in the browser: gestures that select, and a folder of the panel that deletes and saves."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from torch import Tensor

from core_rasterizer import Camera, ExplainedError
from registry import RunError

from .decoration import add_canvas
from .edits import Edits, Stroke, clicked, in_ball, in_rectangle
from .picture import Look, visible
from .subject import Subject

_HELP = """\
**Shift and drag** selects in a rectangle, or what the brush touches; **Shift and click** in a ball around the
surface. With Ctrl too, both remove from the selection. Hidden Gaussians are not selected."""
_ADD, _REMOVE = "shift", "cmd/ctrl+shift"
_RADIUS = 5.0
"""Radius of ball and brush, percent of the distance from the camera."""
_DRAG_DRAWS = ("rectangle", "brush")


class Editor:
    """Selects, deletes and saves Gaussians.

    viser's threads only record what is asked for; `apply` does it, in the thread that renders.

    Args:
        server: viser's.
        subject: the scene.
        look: returns the choices that hide Gaussians.
        camera: returns the camera of one of viser's clients.
        wake: called when there is something to apply.
    """

    def __init__(
        self,
        server: Any,
        subject: Subject,
        *,
        look: Callable[[], Look],
        camera: Callable[[Any], Camera],
        wake: Callable[[], None],
    ) -> None:
        self._look, self._camera, self._wake = look, camera, wake
        self._asked: deque[Callable[[], object]] = deque()
        self._add_panel(server.gui)
        self._scene, self._canvas = server.scene, None
        for modifier in (_ADD, _REMOVE):
            server.scene.on_click(modifier=modifier)(partial(self._ask, self._click))
        self._listen_to_drags()
        self.edit(subject)

    def edit(self, subject: Subject) -> None:
        """Start with a scene; nothing of it is selected."""
        self._subject, self.edits = subject, Edits(subject.model.count)
        self._stroke: Stroke | None = None
        self._source, self._folder.visible = subject.source, subject.source is not None
        self._buttons["Save as run"].visible = bool(self._source and self._source.save_run)
        self._show_numbers()

    @property
    def waits(self) -> bool:
        """True if there is something to apply."""
        return bool(self._asked)

    def apply(self) -> bool:
        """Do what was asked for since the last call; return whether anything was."""
        if not self._asked:
            return False
        while self._asked:
            action = self._asked.popleft()
            if self._source is None:  # asked for just before the scene changed
                continue
            self._said = ""
            try:
                action()
            except ExplainedError as error:
                self._said = f"{error.what}; {error.fix}" if error.fix else error.what
        self._show_numbers()
        return True

    def _add_panel(self, gui: Any) -> None:
        self._said = ""
        self._folder = gui.add_folder("Edit", expand_by_default=False)
        with self._folder:
            gui.add_markdown(_HELP)
            self._drag_draws = gui.add_dropdown("Drag draws", _DRAG_DRAWS)
            self._drag_draws.on_update(lambda _: self._listen_to_drags())
            self._radius = gui.add_slider(
                "Radius, % of distance", min=0.5, max=30.0, step=0.5, initial_value=_RADIUS
            )
            self._numbers = gui.add_markdown("")
            actions: dict[str, Callable[[Any], object]] = {
                "Select all shown": lambda _: self.edits.select(self._shown(), add=True),
                "Invert": lambda _: self.edits.invert(self._shown()),
                "Select none": lambda _: self.edits.select(self.edits.selected, add=False),
                "Delete": lambda _: self.edits.delete(),
                "Undo": lambda _: self.edits.undo(),
                "Save as PLY": lambda _: self._save(as_run=False),
                "Save as run": lambda _: self._save(as_run=True),
            }
            self._buttons = {label: gui.add_button(label) for label in actions}
        for label, action in actions.items():
            self._buttons[label].on_click(partial(self._ask, action))

    def _listen_to_drags(self) -> None:
        """Let drags draw a rectangle, or paint on an invisible sphere: viser follows them on nodes only."""
        if self._canvas is not None:
            self._canvas.remove()
            self._canvas = None
        self._scene.remove_rect_select_callback()
        if self._drag_draws.value == "brush":
            self._canvas = add_canvas(self._scene)
        for modifier in (_ADD, _REMOVE):
            if self._canvas is None:
                self._scene.on_rect_select(modifier=modifier)(partial(self._ask, self._drag))
            else:
                self._canvas.on_drag("left", modifier=modifier)(self._ask_to_paint)

    async def _ask_to_paint(self, event: Any) -> None:
        """viser calls only coroutines in the order of the events."""
        self._ask(self._paint, event)

    def _ask(self, action: Callable[[Any], object], event: Any) -> None:
        self._asked.append(partial(action, event))
        self._wake()

    def _shown(self) -> Tensor:
        mask = visible(self._subject, self._look(), self.edits.deleted)
        return ~self.edits.deleted if mask is None else mask

    def _drag(self, event: Any) -> None:
        """Select the means in a rectangle."""
        means, camera = self._subject.model.read("means"), self._camera(event.client)
        inside = in_rectangle(means, camera, event.screen_min, event.screen_max)
        self.edits.select(inside & self._shown(), add=event.modifier == _ADD)

    def _paint(self, event: Any) -> None:
        """Select the means under the brush; undo takes back a whole stroke."""
        if event.phase == "start":
            camera, shown = self._camera(event.client), self._shown()
            model = self._subject.model
            rendering = model.render(camera, opacity_scale=shown.float())
            means, place = model.read("means"), event.start_screen_pos
            self._stroke = Stroke(means, shown, camera, rendering, place)
        if self._stroke is None:  # the scene has changed since the start
            return
        touched = self._stroke.to(event.end_screen_pos, self._radius.value / 100)
        add, joins = event.modifier == _ADD, self._stroke.changed
        self._stroke.changed |= self.edits.select(touched, add=add, joins=joins)
        if event.phase == "end":
            self._stroke = None

    def _click(self, event: Any) -> None:
        """Select the means near the surface that was clicked."""
        camera, shown = self._camera(event.client), self._shown()
        rendering = self._subject.model.render(camera, opacity_scale=shown.float())
        center = clicked(camera, rendering, event.screen_pos)
        if center is None:
            self._said = "Nothing is there: click on a surface."
            return
        radius = self._radius.value / 100 * float((center - camera.center).norm())
        near = in_ball(self._subject.model.read("means"), center, radius)
        self.edits.select(near & shown, add=event.modifier == _ADD)

    def _save(self, *, as_run: bool) -> None:
        if self.edits.deleted.all():
            raise RunError("all Gaussians are deleted", fix="press Undo")
        if self._source is not None:
            self._said = "Saving ..."
            self._show_numbers()
            write = self._source.save_run if as_run else self._source.save
            self._said = "" if write is None else f"Saved as {write(~self.edits.deleted)}"

    def _show_numbers(self) -> None:
        selected, deleted = int(self.edits.selected.sum()), int(self.edits.deleted.sum())
        numbers = f"{selected:,} selected, {deleted:,} deleted"
        self._numbers.content = f"{numbers}\n\n{self._said}" if self._said else numbers
