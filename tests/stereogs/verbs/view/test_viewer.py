"""The viewer's page over a WebSocket, rendered by the engine."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
import torch

pytest.importorskip("viser")

from websockets.exceptions import InvalidStatus
from websockets.typing import Origin

from core_rasterizer import Camera, Device, GaussianModel, Gaussians, load_ply
from registry import RunError
from registry.testing import tiny_scene
from stereogs.verbs.view.edits import Source
from stereogs.verbs.view.guard import Guard
from stereogs.verbs.view.subject import Subject, start_pose, viewpoints_of
from stereogs.verbs.view.viewer import Viewer
from tests.stereogs.verbs.view.browser import (
    WINDOW,
    Received,
    change,
    click,
    drag,
    move,
    paint,
    visit,
)

SCENE = tiny_scene()


@pytest.fixture
def subject(device: Device) -> Subject:
    """A red wall of Gaussians at z = 2 on the left, a green one at z = 4 on the right."""
    left = torch.cartesian_prod(torch.linspace(-2, -0.2, 12), torch.linspace(-2, 2, 12))
    right = torch.cartesian_prod(torch.linspace(0.4, 4, 12), torch.linspace(-4, 4, 12))
    positions = torch.cat(
        [
            torch.cat([left, torch.full((len(left), 1), 2.0)], dim=1),
            torch.cat([right, torch.full((len(right), 1), 4.0)], dim=1),
        ]
    )
    near = positions[:, 2] < 3
    colors = torch.where(near[:, None], torch.tensor([0.9, 0, 0]), torch.tensor([0, 0.9, 0]))
    count = len(positions)
    gaussians = Gaussians.from_points(
        positions, colors, torch.full((count,), 0.2), torch.full((count,), 0.95), 0
    )
    kinds = {"near": near, "far": ~near}
    return Subject("walls", GaussianModel(gaussians, device), viewpoints_of(SCENE), kinds=kinds)


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port: int = free.getsockname()[1]
        return port


@pytest.fixture
def viewer(subject: Subject) -> Iterator[Viewer]:
    with closing(Viewer(subject, free_port())) as viewer:
        yield viewer


def serve_until(viewer: Viewer, received: Received, true: Callable[[], bool]) -> None:
    end = time.monotonic() + 30
    while not true():
        assert time.monotonic() < end, f"nothing came; texts: {received.texts}"
        viewer.serve(0.05)
        received.read()


def green(picture: np.ndarray | None) -> float:
    """The mean green of the right half."""
    assert picture is not None
    return float(picture[:, picture.shape[1] // 2 :, 1].mean())


def red(picture: np.ndarray | None) -> float:
    """The mean red of the right half."""
    assert picture is not None
    return float(picture[:, picture.shape[1] // 2 :, 0].mean())


def selected(received: Received) -> int:
    """The number of selected Gaussians that the panel shows."""
    (text,) = (text for text in received.texts.values() if " selected, " in text)
    return int(text.split(" selected")[0].replace(",", ""))


def is_grey(picture: np.ndarray | None) -> bool:
    return picture is not None and bool((np.ptp(picture, axis=2) < 8).all())


def test_the_browser_shows_the_scene_and_follows_the_controls(
    viewer: Viewer, subject: Subject
) -> None:
    with visit(viewer.url) as page:
        received = Received(page)
        move(page, (0.0, 0.0, 0.0))
        serve_until(viewer, received, lambda: received.picture is not None)
        first = received.picture
        assert first is not None
        assert first.shape == (WINDOW[1], WINDOW[0], 3)
        expected = subject.model.render(Camera.centered(torch.eye(4), WINDOW[1] / 2, *WINDOW))
        difference = first - expected.rgb.detach().clamp(0, 1).numpy() * 255
        assert np.abs(difference).mean() < 6  # JPEG

        assert {f"/cameras/{view.name}" for view in (*SCENE.train, *SCENE.test)} <= received.nodes
        assert green(first) > 100
        change(page, received.controls["far"], False)
        serve_until(
            viewer,
            received,
            lambda: green(received.picture) < 20,
        )
        change(page, received.controls["Show"], "depth")
        serve_until(viewer, received, lambda: green(received.picture) < 1)
        change(page, received.controls["far"], True)
        change(page, received.controls["Show"], "alpha")
        serve_until(viewer, received, lambda: is_grey(received.picture))
        assert green(received.picture) > 60

        change(page, received.controls["Ellipsoids"], True)
        serve_until(viewer, received, lambda: "/ellipsoids" in received.nodes)
        serve_until(viewer, received, lambda: received.picture is None)
        assert "/crop_box" not in received.nodes
        change(page, received.controls["Show only the inside"], True)
        serve_until(viewer, received, lambda: "/crop_box" in received.nodes)
        change(page, received.controls["Show only the inside"], False)
        serve_until(viewer, received, lambda: "/crop_box" not in received.nodes)


def test_gaussians_are_selected_deleted_and_saved(subject: Subject, tmp_path: Path) -> None:
    gaussians, near = subject.model.gaussians(), subject.kinds["near"]
    source = Source(tmp_path / "scene.ply", lambda: gaussians, {})
    editable = replace(subject, source=source)
    with closing(Viewer(editable, free_port())) as viewer, visit(viewer.url) as page:
        received = Received(page)

        def done(says: str) -> None:
            serve_until(
                viewer, received, lambda: any(says in text for text in received.texts.values())
            )

        def press(label: str, says: str) -> None:
            change(page, received.controls[label], True)
            done(says)

        move(page, (0.0, 0.0, 0.0))
        serve_until(viewer, received, lambda: received.picture is not None)
        assert green(received.picture) > 100
        drag(page, (0.5, -0.1), (1.0, 1.1), "shift")
        visible = int((~near).sum())
        done(f"{visible} selected, 0 deleted")
        serve_until(viewer, received, lambda: red(received.picture) > 100)  # shown as selected
        drag(page, (0.5, -0.1), (1.0, 0.5), "cmd/ctrl+shift")
        done(f"{visible // 2} selected, 0 deleted")
        press("Undo", f"{visible} selected, 0 deleted")
        press("Delete", f"0 selected, {visible} deleted")
        serve_until(viewer, received, lambda: green(received.picture) < 20)
        click(page, (0.75, 0.5), "shift")
        done("Nothing is there: click on a surface.")
        change(page, received.controls["Radius, % of distance"], 15.0)
        click(page, (0.25, 0.5), "shift")
        serve_until(viewer, received, lambda: selected(received) in range(1, 20))
        press("Select none", f"0 selected, {visible} deleted")
        change(page, received.controls["Drag draws"], "brush")
        serve_until(viewer, received, lambda: "/canvas" in received.nodes)
        across = [(0.0, 0.5), (0.2, 0.5), (0.4, 0.5)]
        paint(page, across, "shift")
        serve_until(viewer, received, lambda: selected(received) == 22)  # of two rows
        paint(page, across[:2], "cmd/ctrl+shift")
        serve_until(viewer, received, lambda: 0 < selected(received) < 22)
        press("Undo", f"22 selected, {visible} deleted")
        press("Undo", f"0 selected, {visible} deleted")
        change(page, received.controls["Drag draws"], "rectangle")
        serve_until(viewer, received, lambda: "/canvas" not in received.nodes)
        change(page, received.controls["near"], False)
        drag(page, (0.0, 0.0), (1.0, 1.0), "shift")
        change(page, received.controls["Select all shown"], True)
        press("Save as PLY", "scene-edited.ply")
        assert selected(received) == 0  # hidden ones are not selected
        change(page, received.controls["near"], True)
        kept = load_ply(tmp_path / "scene-edited.ply")
        assert kept.means.equal(gaussians.means[near])
        press("Invert", f"{int(near.sum())} selected")
        press("Delete", "0 selected, 288 deleted")
        press("Save as PLY", "press Undo")


def test_gaussians_in_training_are_not_edited(viewer: Viewer, subject: Subject) -> None:
    with visit(viewer.url) as page:
        received = Received(page)
        move(page, (0.0, 0.0, 0.0))
        serve_until(viewer, received, lambda: received.picture is not None)
        drag(page, (0.0, 0.0), (1.0, 1.0), "shift")
        for _ in range(5):
            viewer.serve(0.05)
            received.read()
        assert selected(received) == 0


def test_a_camera_stays_near_the_photographs_until_it_may_leave(
    viewer: Viewer, subject: Subject
) -> None:
    start, far = start_pose(subject), (30.0, 0.0, 0.0)
    place = tuple((start.position / start.distance).tolist())
    with visit(viewer.url) as page:
        received = Received(page)
        move(page, far)  # a browser's own pose, before it takes the start pose
        serve_until(viewer, received, lambda: received.picture is not None)
        assert received.position == pytest.approx(place)
        for there in (place, far):
            received.picture = received.position = None
            move(page, there)
            serve_until(viewer, received, lambda: received.picture is not None)
        serve_until(viewer, received, lambda: received.position is not None)
        assert received.position is not None
        assert 0.1 < np.linalg.norm(np.subtract(received.position, place)) < 1
        change(page, received.controls["Stay near the photographs"], False)
        received.position = None
        move(page, far)
        received.read(0.5)
        assert received.position is None
        change(page, received.controls["Back to the photographs"], True)
        serve_until(viewer, received, lambda: received.position is not None)
        assert received.position == pytest.approx(tuple(start.position / start.distance))


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere 127.0.0.2 is no address")
def test_the_server_listens_on_localhost_only(viewer: Viewer) -> None:
    """A server that listens on all addresses would answer on this one too."""
    port = urlsplit(viewer.url).port
    with socket.create_connection(("127.0.0.1", port), timeout=5):
        pass
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", port), timeout=5)


def test_new_gaussians_are_shown(viewer: Viewer, subject: Subject, device: Device) -> None:
    with visit(viewer.url) as page:
        received = Received(page)
        move(page, (0.0, 0.0, 0.0))
        serve_until(viewer, received, lambda: received.picture is not None)
        kept = {k: v[subject.kinds["near"]] for k, v in vars(subject.model.gaussians()).items()}
        later = GaussianModel(Gaussians(**kept), device)
        viewer.show(Subject("walls", later, viewpoints_of(SCENE)), 7)
        serve_until(viewer, received, lambda: green(received.picture) < 20)


def answer(viewer: Viewer, path: str = "", **headers: str) -> HTTPResponse:
    """What the server answers to a request for a path, by default the printed address's."""
    address = urlsplit(viewer.url)
    connection = HTTPConnection("127.0.0.1", address.port or 0, timeout=10)
    connection.request("GET", path or f"/?{address.query}", headers=headers)
    return connection.getresponse()


def test_the_printed_address_opens_the_page_and_its_files(viewer: Viewer) -> None:
    page = answer(viewer)
    assert page.status == 200
    cookie = page.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert answer(viewer, "/", Cookie=cookie.partition(";")[0]).status == 200
    own = f"http://localhost:{urlsplit(viewer.url).port}"
    assert answer(viewer, Host=own.removeprefix("http://"), Origin=own).status == 200


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        ("", {"Host": "evil.example"}),
        ("", {"Host": "127.0.0.1.evil.example"}),
        ("", {"Host": "[broken"}),
        ("", {"Origin": "http://evil.example"}),
        ("", {"Origin": "http://localhost:1"}),
        ("", {"Origin": "null"}),
        ("/", {}),
        ("/index.html", {}),
        ("/?token=guessed", {}),
        ("//[", {}),
        ("//[?token=guessed", {}),
        ("/", {"Cookie": "stereogs-1=guessed; a"}),
    ],
)
def test_nobody_else_gets_the_page(viewer: Viewer, path: str, headers: dict[str, str]) -> None:
    refused = answer(viewer, path, **headers)
    assert refused.status == 403
    assert refused.headers["Set-Cookie"] is None
    assert len(refused.read()) < 100


def test_the_token_does_not_open_an_address_that_is_none(viewer: Viewer) -> None:
    query = urlsplit(viewer.url).query
    assert answer(viewer, f"//[?{query}").status == 403
    assert answer(viewer, f"//[::1]/?{query}").status == 403
    assert answer(viewer, f"/nothing?{query}").status == 404


@pytest.mark.parametrize("case", ["foreign origin", "foreign host", "no token"])
def test_another_web_page_cannot_read_the_scene(viewer: Viewer, case: str) -> None:
    """A page in the same browser may open a WebSocket to any address; the browser states its origin."""
    url = viewer.url.partition("?")[0] if case == "no token" else viewer.url
    headers = {"Host": "evil.example"} if case == "foreign host" else {}
    origin = Origin("http://evil.example") if case == "foreign origin" else None
    with pytest.raises(InvalidStatus) as caught, visit(url, origin, headers):
        pass
    assert caught.value.response.status_code == 403


def test_a_server_that_would_not_be_guarded_is_an_error() -> None:
    with pytest.raises(RunError, match="cannot be protected"), Guard().installed():
        pass
