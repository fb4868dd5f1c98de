"""The page of `stereogs view`, and another web page in the same browser that tries to read its scene."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import pytest
import torch

pytest.importorskip("viser")

import viser

from core_rasterizer import GaussianModel, Gaussians, open_device
from registry.testing import tiny_scene
from stereogs.verbs.view.subject import Subject, viewpoints_of
from stereogs.verbs.view.viewer import Viewer

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
