"""Every page that the project makes, of a real run, as a browser shows it."""

from __future__ import annotations

import base64
import io
import json
import math
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image

import stereogs
from tests.browser.conftest import WIDTHS, keep, opened, overflow, until
from tests.host import main

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from playwright.sync_api import Browser, Page

SMALL = (320, 240)
"""Pixels: a view that moves smoothly without a graphics card."""
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
            assert unlike(inside, expected) < unlike(inside, other)


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
    with opened(browser, run / "report.html", 1280, still=True) as page:
        wait_for_scene(page, size=(160, 120))
        scene = stereogs.load_scene(PIPELINE)
        for view in scene.test:
            page.locator(".buttons select").select_option(label=view.name)
            page.wait_for_timeout(3000)
            drawn = canvas(page)
            assert drawn.shape == (120, 160, 3)
            assert drawn.std() > 0.05, "not one colour"
            render = np.asarray(Image.open(run / "renders" / f"{view.name}.png")) / 255
            psnr = -10 * math.log10(float(((drawn - render) ** 2).mean()))
            assert psnr > 32, view.name


@pytest.mark.parametrize("width", WIDTHS)
def test_the_scene_comes_first_and_fills_the_width(browser: Browser, run: Path, width: int) -> None:
    with opened(browser, run / "report.html", width) as page:
        wait_for_scene(page)
        kinds = ".scene-view, h2, table, .wipe"
        order = page.locator(kinds).evaluate_all("all => all.map(part => part.className)")
        assert order[0] == "scene-view"
        box = page.locator(".canvas").bounding_box()
        assert box is not None
        assert box["width"] > 0.9 * width
        assert 300 < box["height"] < 700, "and leaves room to scroll"
        assert page.locator("details:has-text('SHA-256')").get_attribute("open") is None


def test_the_camera_sweeps_until_the_view_is_touched(browser: Browser, run: Path) -> None:
    with opened(browser, run / "report.html", 390) as page:
        wait_for_scene(page, size=SMALL)
        before, picture = eye(page), canvas(page)
        until(page, lambda: distance(before, eye(page)) > 0.1)
        assert np.abs(canvas(page) - picture).mean() > 0.002
        page.locator(".canvas").tap()
        page.get_by_role("button", name="Play").wait_for()
        before = eye(page)
        page.wait_for_timeout(1500)
        assert distance(before, eye(page)) < 1e-3, "it stands still"
        page.get_by_role("button", name="Play").click()
        until(page, lambda: distance(before, eye(page)) > 0.1)


def test_who_prefers_no_motion_sees_none(browser: Browser, run: Path) -> None:
    with opened(browser, run / "report.html", 390, still=True) as page:
        wait_for_scene(page, size=SMALL)
        before = eye(page)
        page.wait_for_timeout(1500)
        assert distance(before, eye(page)) == 0
        page.locator(".buttons select").select_option(label="test_00")
        assert distance(before, eye(page)) > 0.1, "at once"


@pytest.mark.parametrize("direction", [(150, 0), (-150, 0), (0, 150), (0, -150), (900, 300)])
def test_a_drag_stays_near_the_photographs(
    browser: Browser, run: Path, direction: tuple[int, int]
) -> None:
    with opened(browser, run / "report.html", 1280, still=True) as page:
        wait_for_scene(page, size=SMALL)
        limit = setup(page)["limits"]["angle"]
        start = eye(page)
        back = page.get_by_role("button", name="Back to the photographs")
        assert not back.is_visible()
        drag(page, *direction)
        until(page, lambda: distance(start, eye(page)) > 0.3)
        for _ in range(10):
            assert angle_to_photographs(page) < 1.5 * limit, "held"
            page.wait_for_timeout(100)
        page.mouse.up()
        until(page, lambda: angle_to_photographs(page) < 1.05 * limit)
        back.click()
        until(page, lambda: nearest_photograph(page) < 1e-3)
        assert not back.is_visible()


def test_a_finger_turns_the_scene_or_scrolls_the_page(browser: Browser, run: Path) -> None:
    with opened(browser, run / "report.html", 390, still=True) as page:
        wait_for_scene(page, size=SMALL)
        start = eye(page)
        swipe(page, -150, 0)
        until(page, lambda: distance(start, eye(page)) > 0.3)
        assert angle_to_photographs(page) < 1.5 * setup(page)["limits"]["angle"]
        assert page.evaluate("scrollY") == 0
        swipe(page, 0, -150)
        until(page, lambda: page.evaluate("scrollY") > 50)


def test_the_wheel_scrolls_the_page_and_zooms_a_clicked_view(browser: Browser, run: Path) -> None:
    with opened(browser, run / "report.html", 1280, still=True) as page:
        wait_for_scene(page, size=SMALL)
        place = page.locator(".canvas")
        place.hover()
        page.mouse.wheel(0, 50)
        until(page, lambda: page.evaluate("scrollY") > 0)
        place.click()
        before, scrolled = reach(page), page.evaluate("scrollY")
        page.mouse.wheel(0, -3000)
        nearest = setup(page)["limits"]["nearest"]
        until(page, lambda: reach(page) / before < 0.9)
        for _ in range(10):
            assert reach(page) / before > 0.7 * nearest
            page.wait_for_timeout(100)
        assert page.evaluate("scrollY") == scrolled


@pytest.mark.parametrize("width", WIDTHS)
def test_an_exported_page_opens_from_disk(browser: Browser, run: Path, width: int) -> None:
    assert main(["export", str(run), "--format", "html"]) == 0
    with opened(browser, run / "exports" / "scene.html", width) as page:
        wait_for_scene(page)
        keep(page, f"scene-{width}")
        assert overflow(page) <= 0
        box = page.locator(".canvas").bounding_box()
        assert box == {"x": 0, "y": 0, "width": width, "height": 800}
        before = eye(page)
        assert canvas(page).std() > 0.05
        until(page, lambda: distance(before, eye(page)) > 0.1)


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
        page.get_by_text("requires WebGL 2").wait_for()


def wait_for_scene(page: Page, size: tuple[int, int] | None = None) -> None:
    """Wait until the 3D view is drawn, `size` pixels large: small views are fast without a graphics card."""
    if size:
        width, height = (f"{pixels}px !important" for pixels in size)
        style = f".canvas {{width: {width}; height: {height}; min-height: 0 !important}}"
        page.add_style_tag(content=style)
    view = page.locator(".scene-view[data-state]")
    view.wait_for()
    assert view.get_attribute("data-state") == "shown", view.inner_text()
    page.wait_for_timeout(3000)  # the first sorted picture


def drag(page: Page, dx: int, dy: int) -> None:
    """Press in the middle of the view and move, without letting go."""
    box = page.locator(".canvas").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + dx, y + dy, steps=5)


def swipe(page: Page, dx: int, dy: int) -> None:
    """Move a finger that starts in the middle of the view."""
    box = page.locator(".canvas").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    fingers = page.context.new_cdp_session(page)
    points = [{"x": x + dx * k / 10, "y": y + dy * k / 10} for k in range(11)]
    kinds = ["touchStart", *["touchMove"] * 10]
    for kind, point in zip(kinds, points, strict=True):
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [point]})
    fingers.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


def setup(page: Page) -> dict[str, Any]:
    """What the page tells the viewer."""
    text = page.locator("#scene-setup").text_content()
    assert text is not None
    return dict(json.loads(text))


def seen(page: Page, name: str) -> NDArray[np.float64]:
    return np.array(page.evaluate(f"document.querySelector('.scene-view').shown.{name}()"))


def eye(page: Page) -> NDArray[np.float64]:
    """Where the camera is, in the viewer's units: the scene is about 10 wide."""
    return seen(page, "eye")


def reach(page: Page) -> float:
    """How far the camera is from the point that it turns around."""
    return distance(eye(page), seen(page, "target"))


def distance(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(a - b))


def photographs(page: Page) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Position and subject of each training camera."""
    views = [view for view in setup(page)["views"] if view["train"]]
    poses = [np.reshape(view["pose"], (4, 4)) for view in views]
    return [
        (pose[:3, 3], pose[:3, 3] - view["reach"] * pose[:3, 2])
        for pose, view in zip(poses, views, strict=True)
    ]


def nearest_photograph(page: Page) -> float:
    return min(distance(eye(page), place) for place, _ in photographs(page))


def angle_to_photographs(page: Page) -> float:
    """Degrees between the camera and the nearest point of the arcs between two training cameras."""
    here, found = eye(page), []
    views = photographs(page)
    for one, subject in views:
        for other, _ in views:
            for share in np.linspace(0, 1, 9):
                a, b = here - subject, (1 - share) * one + share * other - subject
                cosine = a @ b / np.linalg.norm(a) / np.linalg.norm(b)
                found.append(math.degrees(math.acos(min(1.0, cosine))))
    return min(found)


def canvas(page: Page) -> NDArray[np.float64]:
    """What the 3D view shows, `[H, W, 3]` in [0, 1]."""
    url = page.evaluate("document.querySelector('.canvas canvas').toDataURL()")
    return pixels(base64.b64decode(url.partition(",")[2]))


def pixels(file: bytes) -> NDArray[np.float64]:
    return np.asarray(Image.open(io.BytesIO(file)).convert("RGB")) / 255


def unlike(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Difference between the mean colours along a picture's width, whatever the sizes."""
    columns = [
        np.asarray(Image.fromarray(np.uint8(255 * image)).resize((32, 24))) / 255.0
        for image in (one, other)
    ]
    return float(np.abs(columns[0] - columns[1]).mean())
