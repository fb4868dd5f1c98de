"""A real browser for pages: Chromium without a window, driven by Playwright."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

NAMES = ("chromium", "chromium-browser", "google-chrome")
SCREENSHOTS = Path(__file__).parent / "screenshots"
WIDTHS = (390, 1280)
"""Pixels: of a phone, and of a laptop."""
SOFTWARE_WEBGL = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
MAX_SECONDS = 240
"""For a page to draw its 3D view: software does what a graphics card would."""


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    if os.environ.get("BROWSER") != "1":
        pytest.skip("minutes of a browser without a graphics card: make browser")
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip("there is no Chromium: apt-get install chromium, or brew install chromium")
    reason = "pip install 'stereogs-plugins[browser]'"
    playwright = pytest.importorskip("playwright.sync_api", reason=reason)
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=found, args=SOFTWARE_WEBGL)
        yield browser
        browser.close()


@contextmanager
def opened(
    browser: Browser,
    file: Path,
    width: int,
    *,
    without_webgl: bool = False,
    still: bool = False,
) -> Iterator[Page]:
    """A page in a window of that width; on leaving, nothing may have gone wrong on it.

    It may load files of its own folder and what it made itself, and no error may be in its console.
    `still`: the browser tells pages that its user prefers no motion.
    """
    page = browser.new_page(
        viewport={"width": width, "height": 800},
        has_touch=width < 800,
        reduced_motion="reduce" if still else "no-preference",
    )
    page.set_default_timeout(1000 * MAX_SECONDS)
    wrong: list[str] = []
    inside = ("data:", "blob:", file.parent.absolute().as_uri())
    page.on("request", lambda r: None if r.url.startswith(inside) else wrong.append(r.url))
    page.on("requestfailed", lambda r: wrong.append(f"{r.url[:80]}: {r.failure}"))
    page.on("console", lambda m: wrong.append(m.text) if m.type == "error" else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    if without_webgl:
        page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(file.absolute().as_uri())
    yield page
    broken = "[...document.images].filter(image => !image.complete || !image.naturalWidth).length"
    assert page.evaluate(broken) == 0
    assert wrong == []
    page.close()


def until(page: Page, reached: Callable[[], bool]) -> None:
    """Wait for something that the page does in its own time."""
    end = time.monotonic() + MAX_SECONDS
    while not reached():
        assert time.monotonic() < end, "it did not happen"
        page.wait_for_timeout(50)


def keep(page: Page, name: str) -> None:
    """Keep a picture of the whole page for people."""
    SCREENSHOTS.mkdir(exist_ok=True)
    page.screenshot(path=SCREENSHOTS / f"{name}.png", full_page=True)


def overflow(page: Page) -> int:
    """Pixels that the page is wider than its window."""
    return int(page.evaluate("document.documentElement.scrollWidth - innerWidth"))
