"""A page that is open during training shows the scene and does not change it."""

from __future__ import annotations

import threading
from argparse import Namespace
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser")

from websockets.exceptions import ConnectionClosed

import stereogs
from stereogs import Iteration, Pipeline, Run, RunOptions
from stereogs.api import TrainRequest
from stereogs.verbs.view.live_page import LivePage
from stereogs.verbs.view.option import LiveView
from tests.host import Fit, main
from tests.registry.conftest import TOY_ENTRIES, Install
from tests.stereogs.verbs.view.browser import WINDOW, Received, move, visit

PIPELINE = """\
name: followed
scene: toy_scene
initializer: {use: toy_points, kinds: true}
modifiers: [toy_dropout]
densification: {use: toy_growth, every: 10, stop: 25}
metrics: [psnr]
training: {iterations: 40, sh_degree: 1, sh_every: 10}
"""


@pytest.fixture(autouse=True)
def _toys(install: Install) -> None:
    install("toys", "1.5", TOY_ENTRIES)


class Visitor:
    """A training with an open page whose camera always moves."""

    def __init__(self) -> None:
        self.pages: list[LivePage] = []
        self.pictures: list[np.ndarray] = []
        self.ended = threading.Event()

    def begin(self, run: Run) -> None:
        self.pages.append(LivePage(run, 0))
        arrived = threading.Event()
        self.thread = threading.Thread(target=self._look, args=(self.pages[0].url, arrived))
        self.thread.start()
        assert arrived.wait(10)

    def iterated(self, done: Iteration) -> None:
        self.pages[0].update(done)

    def _look(self, url: str, arrived: threading.Event) -> None:
        with suppress(ConnectionClosed), visit(url) as page:
            received = Received(page)
            for step in range(1000):
                move(page, (0.001 * step, 0.0, 0.0))
                received.read()
                arrived.set()
                if received.picture is not None:
                    self.pictures.append(received.picture)
                if self.ended.is_set():
                    return


def test_an_open_page_shows_the_training_and_does_not_change_it() -> None:
    alone = stereogs.train(PIPELINE, progress=False)
    visitor = Visitor()
    watched = stereogs.train(
        PIPELINE, progress=False, on_begin=visitor.begin, callback=visitor.iterated
    )
    visitor.ended.set()
    visitor.thread.join()
    visitor.pages[0].close()
    assert watched.hash == alone.hash
    assert visitor.pictures
    assert visitor.pictures[-1].shape == (WINDOW[1], WINDOW[0], 3)
    assert visitor.pictures[-1].std() > 5, "not one colour"


def test_without_an_open_page_nothing_is_copied() -> None:
    copies: list[int] = []
    pages: list[LivePage] = []

    def begin(run: Run) -> None:
        pages.append(LivePage(run, 0))
        kept = run.checkpoint

        def counted() -> Any:
            copies.append(run.iteration)
            return kept()

        run.checkpoint = counted

    stereogs.train(
        PIPELINE, progress=False, on_begin=begin, callback=lambda done: pages[0].update(done)
    )
    pages[0].close()
    assert copies == []


def test_a_page_that_fails_does_not_end_the_run(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(*_: object) -> None:
        raise OSError("the browser is gone")

    monkeypatch.setattr("stereogs.verbs.view.viewer.Viewer.show", broken)
    visitor = Visitor()
    run = stereogs.train(
        PIPELINE, progress=False, on_begin=visitor.begin, callback=visitor.iterated
    )
    visitor.ended.set()
    visitor.thread.join()
    assert run.finished
    assert "the page is closed, training continues: the browser is gone" in caplog.text


def test_view_follows_a_training_that_starts_again_and_calls_other_callbacks(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    begun: list[Run] = []
    shown: list[Run] = []
    update = LivePage.update

    def updated(page: LivePage, done: Iteration) -> None:
        shown.append(page.run)
        update(page, done)

    class Again(Fit):
        def corrected(self, done: int, total: int) -> Pipeline | None:
            return begun[0].pipeline if len(begun) == 1 else None

    monkeypatch.setattr(LivePage, "update", updated)
    monkeypatch.setattr(LivePage, "serve_finished_run", lambda page: None)
    request = TrainRequest(Namespace(view=True), 0.0)
    options = RunOptions(
        progress=False, on_begin=begun.append, callback=lambda done: done.number < 2
    )
    with LiveView().running(request, options) as watched:
        run = stereogs.train(PIPELINE, watched, fit=Again(print))
    assert run.iteration == 2
    assert shown == [begun[0], run, run]
    assert capsys.readouterr().out.count("during training") == 1


def test_train_with_view_shows_the_finished_run_until_ctrl_c(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "followed.yaml").write_text(PIPELINE)

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("stereogs.verbs.view.viewer.Viewer.serve", interrupted)
    out = tmp_path / "run"
    assert main(["train", str(tmp_path / "followed.yaml"), "--view", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "during training" in printed
    assert printed.index("hash ") < printed.index("press Ctrl-C to stop")
    assert stereogs.results(out)["iterations"] == 40
