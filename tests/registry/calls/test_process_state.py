from __future__ import annotations

import logging
import os
import random
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from registry import PluginError
from registry.calls.process_state import (
    left_as_found,
    no_global_random_numbers,
    own_random_numbers,
)


@pytest.mark.parametrize(
    ("name", "change", "read"),
    [
        ("the working directory", lambda: os.chdir("/"), Path.cwd),
        (
            "torch's gradient mode",
            lambda: torch.set_grad_enabled(False),
            torch.is_grad_enabled,
        ),
        (
            "torch's default type",
            lambda: torch.set_default_dtype(torch.float64),
            torch.get_default_dtype,
        ),
        ("torch's number of threads", lambda: torch.set_num_threads(3), torch.get_num_threads),
    ],
)
@pytest.mark.parametrize("fails", [False, True])
def test_changed_state_is_restored(
    name: str,
    change: Callable[[], object],
    read: Callable[[], object],
    fails: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    torch.set_num_threads(1)
    before = read()
    error: type[Exception] = KeyError if fails else PluginError

    def meddle() -> None:
        change()
        if fails:
            raise KeyError

    with pytest.raises(error) as caught, left_as_found("somebody"):
        meddle()
    assert read() == before
    assert fails or f"it changed {name}" in str(caught.value)


def test_a_thread_that_keeps_running_causes_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    stop = threading.Event()
    thread = threading.Thread(target=stop.wait, name="leftover", daemon=True)
    with left_as_found("somebody"):
        thread.start()
    stop.set()
    thread.join()
    assert caplog.messages == [
        "somebody left a thread running: 'leftover'; join it before you return"
    ]
    caplog.clear()
    with caplog.at_level(logging.WARNING), left_as_found("somebody"):
        brief = threading.Thread(target=int)
        brief.start()
        brief.join()
    assert not caplog.messages


DRAWS: dict[str, Callable[[], object]] = {
    "torch": lambda: float(torch.rand(())),
    "numpy": lambda: float(np.random.rand()),
    "Python": random.random,
}
SEEDS: dict[str, Callable[[], object]] = {
    "torch": lambda: torch.manual_seed(1),
    "numpy": lambda: np.random.seed(1),
    "Python": lambda: random.seed(1),
}


@pytest.mark.parametrize("whose", DRAWS)
@pytest.mark.parametrize("kind", [DRAWS, SEEDS])
def test_global_random_numbers_are_refused(
    whose: str, kind: dict[str, Callable[[], object]]
) -> None:
    with (
        pytest.raises(PluginError, match=f"drew from {whose}") as caught,
        no_global_random_numbers(),
    ):
        kind[whose]()
    assert "self.generator" in caught.value.fix


def test_own_generators_are_accepted() -> None:
    with no_global_random_numbers():
        torch.rand(3, generator=torch.Generator().manual_seed(1))
        np.random.default_rng(1).random()
        random.Random(1).random()
        with torch.random.fork_rng():
            torch.manual_seed(1)
            torch.rand(3)


@pytest.mark.parametrize("draw", DRAWS.values(), ids=DRAWS)
def test_outside_the_loop_global_generators_are_seeded_and_restored(
    draw: Callable[[], object],
) -> None:
    draw()
    answers = []
    for seed in (2**62 + 5, 2**62 + 5, 6):
        with own_random_numbers(seed):
            answers.append(draw())
        with no_global_random_numbers(), own_random_numbers(seed):
            draw()
        draw()
    assert answers[0] == answers[1] != answers[2]
