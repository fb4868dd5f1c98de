"""The viewer's page: a local server that renders for every browser that has it open.

viser's threads only record which clients need an image; `Viewer.serve` renders in the thread that calls it,
so that nothing is rendered while training uses the same Gaussians.
"""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import redirect_stdout
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from torch import Tensor

from core_rasterizer import Camera
from registry.toolkit.drawing.camera_path import Vector

from . import import_viser
from .decoration import add_box, add_cameras, add_ellipsoids
from .editor import Editor
from .guard import Guard
from .picture import (
    CHANNELS,
    QUICK_SECONDS,
    SHARP_SECONDS,
    Box,
    Channel,
    Look,
    Pace,
    camera_of,
    render,
    visible,
)
from .subject import StartPose, Subject, start_pose

HOST = "127.0.0.1"
SETTLED_SECONDS = 0.25
"""Time without movement before a sharp image is rendered."""
_WINDOW = (1280, 720)
"""Pixels, until a browser has reported the size of its window."""
_MAX_WIDE = 1920
_JPEG_QUALITY = 85
_POLL_SECONDS = 1.0
"""Time between two checks for Ctrl-C."""

Bounds = tuple[tuple[float, float, float], tuple[float, float, float]]


class Viewer:
    """Gaussians in the browser.

    Args:
        subject: the scene.
        port: first port to try; if it is in use, the next free one.

    Raises:
        RunError: viser is not installed (`import_viser`).
    """

    def __init__(self, subject: Subject, port: int) -> None:
        self._subject, self._pace = subject, Pace()
        self._changed = threading.Condition()
        self._moved: dict[int, Any] = {}
        self._blurred: dict[int, Any] = {}
        self._started: set[int] = set()
        self._mask: Tensor | None = None
        self._masked: tuple[Subject, Look, int] | None = None
        self._guard = Guard()
        self._server = _server(port, subject.name, self._guard)
        self._ellipsoids: Any = None
        self._box: Any = None
        self._decorated: tuple[Subject, Look, bool, int] = (subject, Look(), False, 0)
        start = start_pose(subject)
        self._unit = start.distance
        self._reach = start.reach
        self._cameras = add_cameras(
            self._server, subject.viewpoints, start.extent / self._unit, self._unit
        )
        self._controls = _Controls(
            self._server,
            channels=CHANNELS if subject.confidence else CHANNELS[:-1],
            kinds=sorted(subject.kinds),
            bounds=_bounds(subject),
            on_look=self._request_all,
            on_cameras=self._show_cameras,
            has_photographs=start.reach is not None,
            on_back=lambda client: self._go_to_start(client, start),
        )
        self._editor = Editor(
            self._server,
            subject,
            look=lambda: self._controls.look,
            camera=self._camera_of,
            wake=self._wake,
        )
        self._controls.status.content = f"{subject.model.count:,} Gaussians"
        self._set_start(start)
        self._show_cameras(False)  # the start pose is behind the photograph of one of them
        self._server.on_client_connect(self._connect)

    @property
    def url(self) -> str:
        """Address of the page, with the token without which the server answers nothing."""
        return f"http://{HOST}:{self._server.get_port()}/?token={self._guard.token}"

    @property
    def has_clients(self) -> bool:
        """True if a browser has the page open."""
        return bool(self._server.get_clients())

    def show(self, subject: Subject, iteration: int) -> None:
        """Replace the Gaussians; the next `serve` renders them.

        Args:
            subject: of the same scene.
            iteration: number of completed iterations.
        """
        self._subject = subject
        self._editor.edit(subject)
        status = f"{subject.model.count:,} Gaussians after iteration {iteration:,}"
        self._controls.status.content = status
        self._request_all()

    def serve(self, timeout: float) -> None:
        """Render for clients that move within `timeout` seconds; if none does, render sharp images."""
        timeout = min(timeout, SETTLED_SECONDS) if self._blurred else timeout
        with self._changed:
            self._changed.wait_for(lambda: self._moved or self._editor.waits, timeout=timeout)
        if self.serve_moved():
            return
        self._render_all(self._blurred, SHARP_SECONDS)
        self._blurred = {}

    def serve_moved(self) -> bool:
        """Apply edits, and render quick images for clients that moved; return whether there were any."""
        if self._editor.apply():
            self._request_all()
        with self._changed:
            moved, self._moved = self._moved, {}
        if not moved:
            return False
        self._decorate()
        self._blurred |= moved
        self._render_all(moved, QUICK_SECONDS)
        return True

    def serve_until_interrupted(self) -> None:
        """Serve until Ctrl-C."""
        try:
            while True:
                self.serve(_POLL_SECONDS)
        except KeyboardInterrupt:
            return

    def close(self) -> None:
        """Stop the server."""
        with redirect_stdout(io.StringIO()):  # viser prints that it stops
            self._server.stop()

    def _render_all(self, clients: dict[int, Any], seconds: float) -> None:
        """Render for the clients that are still connected."""
        connected = self._server.get_clients()
        for number, client in clients.items():
            if number in connected:
                self._render(client, seconds)

    def _render(self, client: Any, seconds: float) -> None:
        if self._ellipsoids is not None:  # they replace the image
            client.scene.set_background_image(None)
            return
        look, edits = self._controls.look, self._editor.edits
        if (key := (self._subject, look, edits.revision)) != self._masked:
            self._mask, self._masked = visible(self._subject, look, edits.deleted), key
        camera = self._camera_of(client, seconds)
        selected = edits.selected if edits.selected.any() else None
        begin = time.monotonic()
        image, depth = render(self._subject, camera, look.channel, self._mask, selected)
        self._pace.add(camera.width * camera.height, time.monotonic() - begin)
        client.scene.set_background_image(
            image, format="jpeg", jpeg_quality=_JPEG_QUALITY, depth=depth / self._unit
        )

    def _camera_of(self, client: Any, seconds: float = SHARP_SECONDS) -> Camera:
        """Return a client's camera, of a size that probably renders in this time."""
        seen = client.camera
        window = (seen.image_width or _WINDOW[0], seen.image_height or _WINDOW[1])
        shrink = min(1.0, _MAX_WIDE / window[0])
        width, height = self._pace.size(
            round(window[0] * shrink), round(window[1] * shrink), seconds
        )
        axes = Rotation.from_quat(seen.wxyz, scalar_first=True).as_matrix()
        position = np.asarray(seen.position) * self._unit
        return camera_of(axes, position, seen.fov, width, height)

    def _connect(self, client: Any) -> None:
        client.camera.on_update(lambda _: self._follow(client))
        self._request(client)

    def _follow(self, client: Any) -> None:
        """Render for a client that moved, after its camera is back near the photographs."""
        seen = client.camera
        if self._reach is not None and self._controls.stays_near:
            here = [np.asarray(place) * self._unit for place in (seen.position, seen.look_at)]
            eye, target = self._reach.limited(here[0], here[1])
            # A new browser reports its default pose before it applies the start pose.
            if eye is here[0]:
                self._started.add(client.client_id)
            elif client.client_id in self._started:
                self._place(client, eye, target)
        self._request(client)

    def _place(self, client: Any, eye: Vector, target: Vector) -> None:
        with client.atomic():  # viser ignores a place that is where the camera is
            client.camera.position = tuple(eye / self._unit)
            client.camera.look_at = tuple(target / self._unit)

    def _request(self, client: Any) -> None:
        with self._changed:
            self._moved[client.client_id] = client
            self._changed.notify()

    def _wake(self) -> None:
        with self._changed:
            self._changed.notify()

    def _request_all(self) -> None:
        for client in self._server.get_clients().values():
            self._request(client)

    def _show_cameras(self, visible: bool) -> None:
        for frustum in self._cameras:
            frustum.visible = visible

    def _decorate(self) -> None:
        """Update the ellipsoids and the crop box."""
        subject, look, ellipsoids = self._subject, self._controls.look, self._controls.ellipsoids
        edits = self._editor.edits
        if self._decorated == (key := (subject, look, ellipsoids, edits.revision)):
            return
        self._decorated = key
        for handle in filter(None, (self._ellipsoids, self._box)):
            handle.remove()
        self._ellipsoids = self._box = None
        if ellipsoids:
            gaussians, mask = subject.model.gaussians(), visible(subject, look, edits.deleted)
            self._ellipsoids = add_ellipsoids(self._server, gaussians, mask, self._unit)
        if look.box is not None:
            self._box = add_box(self._server, look.box, self._unit)

    def _go_to_start(self, client: Any, pose: StartPose) -> None:
        """Place one browser's camera where the page opened."""
        with client.atomic():
            client.camera.up_direction = tuple(pose.up)
            self._place(client, pose.position, pose.look_at)

    def _set_start(self, pose: StartPose) -> None:
        self._server.scene.set_up_direction(pose.up)
        start = self._server.initial_camera
        # The browser's depth is fixed-point: its unit is the distance to the orbit point.
        start.position, start.look_at = (
            tuple(place / self._unit) for place in (pose.position, pose.look_at)
        )
        start.up, start.fov = tuple(pose.up), pose.field_of_view


class _Controls:
    """The panel next to the image.

    Args:
        bounds: lowest and highest corner of the crop box, world units.
        on_look: called when the image must be rendered again.
        on_cameras: called with True to show the cameras, False to hide them.
        has_photographs: whether the camera can stay near some.
        on_back: called with the client that wants its camera where the page opened.
    """

    def __init__(
        self,
        server: Any,
        *,
        channels: Sequence[Channel],
        kinds: Iterable[str],
        bounds: Bounds,
        on_look: Callable[[], None],
        on_cameras: Callable[[bool], None],
        has_photographs: bool,
        on_back: Callable[[Any], None],
    ) -> None:
        gui = server.gui
        self.status = gui.add_markdown("")
        back = "Back to the photographs" if has_photographs else "Back to the start"
        gui.add_button(back).on_click(lambda event: on_back(event.client))
        self._near = gui.add_checkbox(
            "Stay near the photographs", has_photographs, visible=has_photographs
        )
        self._channel = gui.add_dropdown("Show", tuple(channels), initial_value=channels[0])
        cameras = gui.add_checkbox("Cameras", False)
        cameras.on_update(lambda _: on_cameras(cameras.value))
        self._ellipsoids = gui.add_checkbox("Ellipsoids", False)
        self._kinds = {}
        kinds = tuple(kinds)
        if kinds:
            with gui.add_folder("Kinds of points"):
                self._kinds = {kind: gui.add_checkbox(kind, True) for kind in kinds}
        with gui.add_folder("Crop box", expand_by_default=False):
            self._cropped = gui.add_checkbox("Show only the inside", False)
            self._ranges = [
                gui.add_multi_slider(
                    axis, min=low, max=high, step=(high - low) / 200, initial_value=(low, high)
                )
                for axis, low, high in zip("xyz", *bounds, strict=True)
            ]
        switches = (self._channel, self._ellipsoids, *self._kinds.values())
        for handle in (*switches, self._cropped, *self._ranges):
            handle.on_update(lambda _: on_look())

    @property
    def stays_near(self) -> bool:
        """True if the camera stays within the limits of the report."""
        return bool(self._near.value)

    @property
    def ellipsoids(self) -> bool:
        """True if ellipsoids replace the image."""
        return bool(self._ellipsoids.value)

    @property
    def look(self) -> Look:
        """The current choices."""
        box = None
        if self._cropped.value:
            x, y, z = (slider.value for slider in self._ranges)
            box = Box((x[0], y[0], z[0]), (x[1], y[1], z[1]))
        hidden = tuple(kind for kind, switch in self._kinds.items() if not switch.value)
        return Look(self._channel.value, hidden, box)


def _bounds(subject: Subject) -> Bounds:
    """Return the corners of a box that contains all but the outermost Gaussians."""
    means = subject.model.read("means").numpy()
    low, high = np.quantile(means, (0.005, 0.995), axis=0)
    margin = 0.05 * (high - low) + 1e-6
    (x, y, z), (u, v, w) = (low - margin).tolist(), (high + margin).tolist()
    return (x, y, z), (u, v, w)


def _server(port: int, title: str, guard: Guard) -> Any:
    viser = import_viser()
    with redirect_stdout(io.StringIO()), guard.installed():  # viser prints a box with addresses
        server = viser.ViserServer(host=HOST, port=port, label=title, verbose=False)
    # The share button would publish the page through a server on the internet.
    server.gui.configure_theme(show_share_button=False)
    return server
