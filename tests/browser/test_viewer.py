"""The page of `stereogs view`: who may connect, and an edit with the pointer."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import pytest
import torch

pytest.importorskip("viser")

import viser

import stereogs
from core_rasterizer import GaussianModel, Gaussians, open_device
from registry.testing import tiny_scene
from stereogs.verbs.view.subject import Subject, of_run, viewpoints_of
from stereogs.verbs.view.viewer import Viewer
from tests.browser.conftest import MAX_SECONDS, keep, until

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page


@pytest.fixture
def viewer(browser: Browser) -> Iterator[Viewer]:
    means = torch.randn(100, 3) + torch.tensor([0.0, 0.0, 4.0])
    sizes = torch.full((100,), 0.2)
    gaussians = Gaussians.from_points(means, means * 0 + 0.5, sizes, sizes, 0)
    model = GaussianModel(gaussians, open_device())
    viewer = Viewer(Subject("dots", model, viewpoints_of(tiny_scene())), 8080)
    yield viewer
    viewer.close()


@pytest.fixture
def elsewhere(tmp_path: Path) -> Iterator[str]:
    """A page of another server on this computer; the browser sends the viewer's cookie along."""
    (tmp_path / "index.html").write_text("<!doctype html><title>elsewhere</title>")
    handler = partial(SimpleHTTPRequestHandler, directory=tmp_path)
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/index.html"
    server.shutdown()


def connects(page: Page, url: str) -> bool:
    """Whether the page gets a connection to the viewer's server."""
    address = f"ws://{urlsplit(url).netloc}/"
    script = """([address, protocol]) => new Promise((resolve) => {
        const socket = new WebSocket(address, protocol);
        socket.onopen = () => resolve(true);
        socket.onerror = () => resolve(false);
    })"""
    return bool(page.evaluate(script, [address, f"viser-v{viser.__version__}"]))


def test_the_page_connects_and_another_page_cannot(
    browser: Browser, viewer: Viewer, elsewhere: str
) -> None:
    context = browser.new_context()
    page = context.new_page()
    answer = page.goto(viewer.url)
    assert answer is not None
    assert answer.ok
    page.wait_for_function("document.querySelector('canvas')")
    assert connects(page, viewer.url), "by the cookie"
    stranger = context.new_page()
    stranger.goto(elsewhere)
    assert not connects(stranger, viewer.url)
    context.close()


PIPELINE = """\
name: painted
scene: {use: procedural, width: 96, height: 72, test_views: 2, points: 3000}
initializer: {use: sfm}
metrics: [psnr]
training: {iterations: 30, sh_degree: 0}
"""


@contextmanager
def served(viewer: Viewer) -> Iterator[None]:
    """Serve in another thread: Playwright waits in this one."""
    ended = threading.Event()

    def serve() -> None:
        while not ended.is_set():
            viewer.serve(0.1)

    thread = threading.Thread(target=serve)
    thread.start()
    yield
    ended.set()
    thread.join()
    viewer.close()


def stroke(page: Page, keys: Sequence[str], places: Sequence[tuple[int, int]]) -> None:
    """Move the pressed pointer with keys held."""
    for key in keys:
        page.keyboard.down(key)
    page.mouse.move(*places[0])
    page.mouse.down()
    for x, y in places[1:]:
        page.mouse.move(x, y, steps=4)
    page.mouse.up()
    for key in keys:
        page.keyboard.up(key)


def selected(page: Page) -> int:
    return int(page.get_by_text(" selected, ").inner_text().split()[0].replace(",", ""))


def test_what_the_brush_touches_is_deleted_and_the_rest_saved_as_a_run(
    browser: Browser, tmp_path: Path
) -> None:
    stereogs.train(PIPELINE, out=tmp_path / "run", progress=False)
    run = stereogs.open_run(tmp_path / "run")
    viewer = Viewer(of_run(run), 8080)
    with served(viewer):
        page = browser.new_page(viewport={"width": 800, "height": 600})
        page.set_default_timeout(1000 * MAX_SECONDS)
        page.goto(viewer.url)
        page.wait_for_function("document.querySelector('canvas')")
        page.get_by_text("Edit", exact=True).click()
        page.get_by_label("Drag draws").first.click()
        page.get_by_role("option", name="brush").click()
        page.wait_for_timeout(2000)  # the sphere that is painted on
        way = [(100, 250), (250, 300), (400, 350)]
        stroke(page, ["Shift"], way)
        until(page, lambda: selected(page) > 20)
        page.wait_for_timeout(2000)
        painted = selected(page)
        keep(page, "painted")
        stroke(page, ["Control", "Shift"], way[:2])
        until(page, lambda: 0 < selected(page) < painted)
        page.get_by_role("button", name="Undo").click()
        until(page, lambda: selected(page) == painted)
        page.get_by_role("button", name="Delete").click()
        page.get_by_role("button", name="Save as run").click()
        page.get_by_text("Saved as").wait_for()
        page.close()
    edited = stereogs.open_run(tmp_path / "run-edited")
    before, after = run.model.gaussians().means, edited.model.gaussians().means
    assert len(before) - len(after) == painted
    assert edited.folder_or_refuse().results()["edits"][0]["removed"] == painted
