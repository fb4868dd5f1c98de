"""A browser simulated by viser's messages over a WebSocket."""

from __future__ import annotations

import io
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from numpy.typing import NDArray
from PIL import Image
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Origin, Subprotocol

WINDOW = (96, 72)


def visit(
    url: str, origin: Origin | None = None, headers: dict[str, str] | None = None
) -> Connection:
    """Open the page's connection, as a page of that origin."""
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    return connect(
        url.replace("http", "ws"),
        origin=origin,
        subprotocols=[protocol],
        compression=None,
        additional_headers=headers,
    )


def move(
    page: Connection,
    position: tuple[float, ...],
    quaternion: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0),
) -> None:
    """Send a camera pose in the page's units, with a field of view of 90 degrees."""
    width, height = WINDOW
    message = {
        "type": "ViewerCameraMessage",
        "wxyz": quaternion,
        "position": position,
        "fov": np.pi / 2,
        "near": 0.01,
        "far": 1000.0,
        "image_height": height,
        "image_width": width,
        "look_at": (0.0, 0.0, 1.0),
        "up_direction": (0.0, -1.0, 0.0),
    }
    page.send(msgspec.msgpack.encode(message))


def change(page: Connection, control: str, value: object) -> None:
    """Set a control of the panel, by viser's identifier."""
    update = {"type": "GuiUpdateMessage", "uuid": control, "updates": {"value": value}}
    page.send(msgspec.msgpack.encode(update))


def drag(
    page: Connection, low: tuple[float, float], high: tuple[float, float], modifier: str
) -> None:
    """Drag a rectangle, from 0 to 1 in the image, with a key held."""
    _point(page, {"event_type": "rect-select", "screen_pos": (low, high), "modifier": modifier})


def click(page: Connection, place: tuple[float, float], modifier: str) -> None:
    """Click at a place, from 0 to 1 in the image, with a key held."""
    ray = {"ray_origin": (0.0, 0.0, 0.0), "ray_direction": (0.0, 0.0, 1.0)}
    _point(page, {"event_type": "click", "screen_pos": (place,), "modifier": modifier, **ray})


def paint(page: Connection, places: list[tuple[float, float]], modifier: str) -> None:
    """Drag the brush over places, from 0 to 1 in the image, with a key held."""
    phases = ["start", *["update"] * (len(places) - 2), "end"]
    nowhere = (0.0, 0.0, 0.0)
    for phase, place in zip(phases, places, strict=True):
        message = {
            "type": "SceneNodeDragMessage",
            "phase": phase,
            "name": "/canvas",
            "instance_index": None,
            "start_position": nowhere,
            "start_screen_pos": places[0],
            "end_position": nowhere,
            "end_screen_pos": place,
            "button": "left",
            "modifier": modifier,
        }
        page.send(msgspec.msgpack.encode(message))


def _point(page: Connection, event: dict[str, Any]) -> None:
    message = {"type": "ScenePointerMessage", "ray_origin": None, "ray_direction": None, **event}
    page.send(msgspec.msgpack.encode(message))


class Received:
    """What the server has sent so far.

    Attributes:
        controls: viser's identifier of each control, by its label.
        texts: the last text of each piece of Markdown, by viser's identifier.
        nodes: names of what the browser draws itself.
        picture: the last one received, `[H, W, 3]`; None if the server removed it.
        position: where the server last placed the camera, in the page's units; None if it did not.
    """

    def __init__(self, page: Connection) -> None:
        self._page = page
        self.controls: dict[str, str] = {}
        self.texts: dict[str, str] = {}
        self.nodes: set[str] = set()
        self.picture: NDArray[np.uint8] | None = None
        self.position: tuple[float, ...] | None = None

    def read(self, seconds: float = 0.05) -> None:
        """Read messages until none arrives for this time."""
        while True:
            try:
                frame = self._page.recv(timeout=seconds)
            except TimeoutError:
                return
            assert isinstance(frame, bytes)
            size = int.from_bytes(frame[8:16], "little")
            content = zstandard.ZstdDecompressor().decompress(frame[16 : 16 + size])
            for message in msgspec.msgpack.decode(content)["messages"]:
                self._take(message)

    def _take(self, message: dict[str, Any]) -> None:
        kind, props = message["type"], message.get("props") or message.get("updates") or {}
        if "_markdown" in props:
            self.texts[message["uuid"]] = props["_markdown"]
        if kind == "BackgroundImageMessage":
            data = message["rgb_data"]
            self.picture = None if data is None else np.asarray(Image.open(io.BytesIO(data)))
        elif kind == "SetCameraPositionMessage":
            self.position = tuple(message["position"])
        elif kind.startswith("Gui") and "label" in props:
            self.controls[props["label"]] = message["uuid"]
        elif kind == "RemoveSceneNodeMessage":
            self.nodes.discard(message["name"])
        elif "name" in message and props:
            self.nodes.add(message["name"])
