"""The page: a server on this machine alone, that renders for whoever has it open.

viser's threads only note who wants a picture; `Viewer.serve` draws, in the thread of whoever calls it. So
nothing is rendered while training works with the same Gaussians.
"""

from __future__ import annotations

import io
import threading
import time
from contextlib import redirect_stdout
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from .controls import Bounds, Controls
from .decoration import add_box, add_cameras, add_ellipsoids
from .pace import QUICK_SECONDS, SHARP_SECONDS, Pace
from .package import import_viser
from .picture import Look, camera_of, kept, pictured
from .start_pose import StartPose, start_pose
from .subject import Subject

HOST = "127.0.0.1"
SETTLED_SECONDS = 0.25
"""How long a visitor has to stand still for a sharp picture."""
_WINDOW = (1280, 720)
"""Pixels, of a window that has not told its size yet."""
_MOST_WIDE = 1920
_JPEG_QUALITY = 85
_PATIENCE = 1.0
"""Seconds between two looks at whether Ctrl-C was pressed."""


class Viewer:
    """Gaussians in the browser.

    Args:
        subject: what is shown.
        port: of this machine that is tried first; the next free one is taken.

    Raises:
        RunError: viser is not installed (`import_viser`).
    """

    def __init__(self, subject: Subject, port: int) -> None:
        self._subject, self._pace = subject, Pace()
        self._changed = threading.Condition()
        self._moved: dict[int, Any] = {}
        self._rough: dict[int, Any] = {}
        self._drawn = kept(subject, Look())
        self._looked: tuple[Subject, Look] = (subject, Look())
        self._server = _server(port, subject.name)
        self._ellipsoids: Any = None
        self._box: Any = None
        self._shown: tuple[Subject, Look, bool] = (subject, Look(), False)
        start = start_pose(subject)
        self._unit = start.distance
        self._cameras = add_cameras(
            self._server, subject.standpoints, start.extent / self._unit, self._unit
        )
        self._controls = Controls(
            self._server,
            kinds=sorted(subject.kinds),
            bounds=_bounds(subject),
            on_look=self._everyone,
            on_cameras=self._show_cameras,
        )
        self._tell(f"{subject.model.count:,} Gaussians")
        self._stand(start)
        self._server.on_client_connect(self._welcome)

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self._server.get_port()}"

    @property
    def is_visited(self) -> bool:
        """Whether somebody has the page open."""
        return bool(self._server.get_clients())

    def show(self, subject: Subject, iteration: int) -> None:
        """Show what training has made of the Gaussians; `serve` draws it.

        Args:
            subject: of the same scene as before.
            iteration: the last one that is complete.
        """
        self._subject = subject
        self._tell(f"{subject.model.count:,} Gaussians after iteration {iteration:,}")
        self._everyone()

    def serve(self, patience: float) -> None:
        """Draw for those who moved; when nobody has for a moment, draw sharply.

        Args:
            patience: seconds to wait for somebody who moves.
        """
        waiting = min(patience, SETTLED_SECONDS) if self._rough else patience
        with self._changed:
            self._changed.wait_for(lambda: bool(self._moved), timeout=waiting)
        if self.serve_moved():
            return
        self._draw_all(self._rough, SHARP_SECONDS)
        self._rough = {}

    def serve_moved(self) -> bool:
        """Draw quickly for those who moved; whether there was anybody."""
        with self._changed:
            moved, self._moved = self._moved, {}
        if not moved:
            return False
        self._decorate()
        self._rough |= moved
        self._draw_all(moved, QUICK_SECONDS)
        return True

    def serve_until_interrupted(self) -> None:
        """Draw for whoever moves, until Ctrl-C."""
        try:
            while True:
                self.serve(_PATIENCE)
        except KeyboardInterrupt:
            return

    def close(self) -> None:
        """End the server."""
        with redirect_stdout(io.StringIO()):  # it says that it has
            self._server.stop()

    def _draw_all(self, clients: dict[int, Any], seconds: float) -> None:
        """Draw for those who have not left."""
        there = self._server.get_clients()
        for number, client in clients.items():
            if number in there:
                self._draw(client, seconds)

    def _draw(self, client: Any, seconds: float) -> None:
        if self._ellipsoids is not None:  # they stand in for the picture
            client.scene.set_background_image(None)
            return
        look, seen = self._controls.look, client.camera
        if (self._subject, look) != self._looked:
            self._drawn, self._looked = kept(self._subject, look), (self._subject, look)
        window = (seen.image_width or _WINDOW[0], seen.image_height or _WINDOW[1])
        shrink = min(1.0, _MOST_WIDE / window[0])
        width, height = self._pace.size(
            round(window[0] * shrink), round(window[1] * shrink), seconds
        )
        axes = Rotation.from_quat(seen.wxyz, scalar_first=True).as_matrix()
        position = np.asarray(seen.position) * self._unit
        camera = camera_of(axes, position, seen.fov, width, height)
        begin = time.monotonic()
        image, depth = pictured(self._subject, camera, look.channel, self._drawn)
        self._pace.took(width * height, time.monotonic() - begin)
        client.scene.set_background_image(
            image, format="jpeg", jpeg_quality=_JPEG_QUALITY, depth=depth / self._unit
        )

    def _welcome(self, client: Any) -> None:
        client.camera.on_update(lambda _: self._wants(client))
        self._wants(client)

    def _wants(self, client: Any) -> None:
        with self._changed:
            self._moved[client.client_id] = client
            self._changed.notify()

    def _everyone(self) -> None:
        for client in self._server.get_clients().values():
            self._wants(client)

    def _tell(self, text: str) -> None:
        self._controls.status.content = text

    def _show_cameras(self, visible: bool) -> None:
        for frustum in self._cameras:
            frustum.visible = visible

    def _decorate(self) -> None:
        """Bring the ellipsoids and the crop box up to what is chosen."""
        subject, look, ellipsoids = self._subject, self._controls.look, self._controls.ellipsoids
        if self._shown == (subject, look, ellipsoids):
            return
        self._shown = (subject, look, ellipsoids)
        for handle in filter(None, (self._ellipsoids, self._box)):
            handle.remove()
        self._ellipsoids = self._box = None
        if ellipsoids:
            gaussians, drawn = subject.model.gaussians(), kept(subject, look)
            self._ellipsoids = add_ellipsoids(self._server, gaussians, drawn, self._unit)
        if look.box is not None:
            self._box = add_box(self._server, look.box, self._unit)

    def _stand(self, pose: StartPose) -> None:
        self._server.scene.set_up_direction(pose.up)
        start = self._server.initial_camera
        # The browser's depth has a fixed point: its unit is the distance to what is looked at.
        start.position, start.look_at = (
            tuple(place / self._unit) for place in (pose.position, pose.look_at)
        )
        start.up, start.fov = tuple(pose.up), pose.field_of_view


def _bounds(subject: Subject) -> Bounds:
    """The corners of the box that holds all but the farthest Gaussians."""
    means = subject.model.read("means").numpy()
    low, high = np.quantile(means, (0.005, 0.995), axis=0)
    margin = 0.05 * (high - low) + 1e-6
    (x, y, z), (u, v, w) = (low - margin).tolist(), (high + margin).tolist()
    return (x, y, z), (u, v, w)


def _server(port: int, title: str) -> Any:
    viser = import_viser()
    with redirect_stdout(io.StringIO()):  # it draws a box with addresses
        server = viser.ViserServer(host=HOST, port=port, label=title, verbose=False)
    # Its button for sharing would hand the page to a server on the internet.
    server.gui.configure_theme(show_share_button=False)
    return server
