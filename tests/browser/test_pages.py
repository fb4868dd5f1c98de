"""Every page that the project makes, of a real run, as a browser shows it."""

from __future__ import annotations

import base64
import io
import math
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

import stereogs
from registry.cli import main

from .conftest import WIDTHS, keep, opened, overflow

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from playwright.sync_api import Browser, Page

PIPELINE = """\
name: tiny
scene: {use: procedural, width: 160, height: 120, test_views: 2, points: 3000}
initializer: {use: sfm}
modifiers: [dropout]
metrics: [psnr]
reports: [html]
training: {iterations: 200, sh_degree: 1, sh_every: 50}
"""


@pytest.fixture(scope="session")
def run(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run's folder; the browser is asked for first, so that nothing is trained without one."""
    folder = tmp_path_factory.mktemp("pages") / "run"
    stereogs.train(PIPELINE, out=folder, progress=False)
    return folder


@pytest.fixture(scope="session")
def comparison(run: Path) -> Path:
    text = io.StringIO()
    with redirect_stdout(text):
        assert main(["compare", str(run), str(run), "--format", "page"]) == 0
    (run.parent / "comparison.html").write_text(text.getvalue(), "utf-8")
    return run.parent / "comparison.html"


@pytest.fixture(scope="session")
def ablation(run: Path) -> Path:
    pipeline, out = run.parent / "tiny.yaml", run.parent / "ablation"
    pipeline.write_text(PIPELINE)
    command = ["ablate", str(pipeline), "--toggle", "dropout", "--out", str(out), "--jobs", "1"]
    assert main([*command, "--set", "training.iterations=20"]) == 0
    return out / "index.html"


@pytest.fixture(scope="session")
def bench(run: Path) -> Path:
    (run.parent / "tiny.yaml").write_text(
        PIPELINE.replace("training: {", "training: {evaluate_every: 10, ")
    )
    matrix, out = run.parent / "matrix.yaml", run.parent / "bench"
    scene = "{use: procedural, width: 160, height: 120, test_views: 2, points: 3000}"
    matrix.write_text(f"pipelines: [tiny.yaml]\nscenes: [{scene}]\niterations: [20, 60]\n")
    assert main(["bench", str(matrix), "--out", str(out), "--jobs", "1"]) == 0
    return out / "index.html"


@pytest.fixture(params=("report", "comparison", "ablation"))
def page_file(request: pytest.FixtureRequest, run: Path) -> Path:
    name = request.param
    return run / "report.html" if name == "report" else Path(request.getfixturevalue(name))


@pytest.mark.parametrize("width", WIDTHS)
def test_a_page_fits_its_window_and_lets_choose_a_view(
    browser: Browser, page_file: Path, width: int
) -> None:
    with opened(browser, page_file, width) as page:
        if page.locator(".scene-view").count():
            wait_for_scene(page)
        keep(page, f"{page_file.stem}-{width}")
        assert overflow(page) <= 0
        parts = page.locator(".choice > div")
        assert [parts.nth(k).is_visible() for k in (0, 1)] == [True, False]
        page.locator(".choice select").first.select_option(index=1)
        assert [parts.nth(k).is_visible() for k in (0, 1)] == [False, True]


def test_the_photograph_stays_beside_the_renders(browser: Browser, comparison: Path) -> None:
    with opened(browser, comparison, 390) as page:
        last = page.locator(".pinned .grid figure").nth(1)
        last.scroll_into_view_if_needed()
        page.mouse.wheel(0, 60)
        place = page.locator(".pinned > div").first.bounding_box()
        assert place is not None
        assert 0 <= place["y"] < 100, "still at the top of the window"


def test_the_border_between_photograph_and_render_moves(browser: Browser, run: Path) -> None:
    with opened(browser, run / "report.html", 1280) as page:
        wait_for_scene(page)
        handle = page.locator(".wipe input").first
        shown = {}
        for place in ("0", "100"):
            handle.fill(place)
            shown[place] = pixels(page.locator(".wipe").first.screenshot())
        pictures = page.locator(".wipe img").evaluate_all("images => images.map(i => i.src)")
        render, photograph = (pixels(base64.b64decode(s.split(",")[1])) for s in pictures[:2])
        for place, expected, other in (("0", render, photograph), ("100", photograph, render)):
            inside = shown[place][40 : -40 - 40]  # without corners and handle
            assert distance(inside, expected) < distance(inside, other)


@pytest.mark.parametrize("width", WIDTHS)
def test_a_bench_draws_curves_and_wipes_the_chosen_render(
    browser: Browser, bench: Path, width: int
) -> None:
    with opened(browser, bench, width) as page:
        keep(page, f"bench-{width}")
        assert overflow(page) <= 0
        assert page.get_by_text("psnr at equal time").is_visible()
        plot = page.locator("svg[aria-label*='psnr against seconds']")
        box = plot.bounding_box()
        assert box is not None
        assert box["width"] <= width
        assert plot.locator("polyline").count() == 2
        assert plot.locator("circle.mark").count() >= 1
        which = page.locator(".choice .choice select").first
        wipe = page.locator(".wipe:visible img").nth(1)
        before = wipe.get_attribute("src")
        which.select_option(index=1)
        assert page.locator(".wipe:visible").count() == 1
        assert page.locator(".wipe:visible img").nth(1).get_attribute("src") == before, "photograph"
        render = page.locator(".wipe:visible img").first.get_attribute("src")
        which.select_option(index=0)
        assert page.locator(".wipe:visible img").first.get_attribute("src") != render


def test_the_scene_is_drawn_as_the_engine_renders_it(browser: Browser, run: Path) -> None:
    with opened(browser, run / "report.html", 1280) as page:
        page.add_style_tag(content=".canvas {width: 160px !important}")
        wait_for_scene(page)
        scene = stereogs.load_scene(PIPELINE)
        for index, view in enumerate(scene.test):
            page.locator(".scene-view select").select_option(index=index)
            page.wait_for_timeout(3000)
            drawn = canvas(page)
            assert drawn.shape == (120, 160, 3)
            assert drawn.std() > 0.05, "not one colour"
            render = np.asarray(Image.open(run / "renders" / f"{view.name}.png")) / 255
            psnr = -10 * math.log10(float(((drawn - render) ** 2).mean()))
            assert psnr > 32, view.name


def test_the_scene_turns_with_the_mouse(browser: Browser, run: Path) -> None:
    with opened(browser, run / "report.html", 390) as page:
        wait_for_scene(page)
        box = page.locator(".canvas").bounding_box()
        assert box is not None
        before = canvas(page)
        page.mouse.move(box["x"] + 50, box["y"] + 50)
        page.mouse.down()
        page.mouse.move(box["x"] + 120, box["y"] + 60, steps=4)
        page.mouse.up()
        page.wait_for_timeout(3000)
        assert np.abs(canvas(page) - before).mean() > 0.02


def test_what_lies_beside_a_page_is_found(browser: Browser, run: Path) -> None:
    moved = run.parent / "beside"
    assert main(["report", str(run), "--beside"]) == 0
    try:
        moved.mkdir()
        for name in ("report.html", "report_files"):
            (run / name).rename(moved / name)
        with opened(browser, moved / "report.html", 390) as page:
            wait_for_scene(page)
            assert canvas(page).std() > 0.05
    finally:
        assert main(["report", str(run), "--inline"]) == 0


def test_a_browser_without_webgl_says_so(browser: Browser, run: Path) -> None:
    with opened(browser, run / "report.html", 390, without_webgl=True) as page:
        page.get_by_text("needs WebGL 2").wait_for()


def wait_for_scene(page: Page) -> None:
    view = page.locator(".scene-view[data-state]")
    view.wait_for()
    assert view.get_attribute("data-state") == "shown", view.inner_text()
    page.wait_for_timeout(3000)  # the first sorted picture


def canvas(page: Page) -> NDArray[np.float64]:
    """What the 3D view shows, `[H, W, 3]` in [0, 1]."""
    url = page.evaluate("document.querySelector('.canvas canvas').toDataURL()")
    return pixels(base64.b64decode(url.partition(",")[2]))


def pixels(file: bytes) -> NDArray[np.float64]:
    return np.asarray(Image.open(io.BytesIO(file)).convert("RGB")) / 255


def distance(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Between the mean colours along a picture's width, whatever the sizes."""
    columns = [
        np.asarray(Image.fromarray(np.uint8(255 * image)).resize((32, 24))) / 255.0
        for image in (one, other)
    ]
    return float(np.abs(columns[0] - columns[1]).mean())
