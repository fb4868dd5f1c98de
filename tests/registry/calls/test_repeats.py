"""Calls of components that are repeated on a copy."""

from __future__ import annotations

import logging
import math
import time

import pytest

from core_rasterizer import Device
from registry import Context, Metric, PluginError, Settings
from registry.calls.repeats import answer_of


class Counting(Metric[Settings]):
    """Answers with its own number, a clock in tenths of milliseconds, or how often any was called."""

    calls = 0
    total = 0

    def measure(self, *kind: str) -> float:  # type: ignore[override]
        self.calls += 1
        Counting.total += 1
        logging.getLogger("stereogs.counting").warning("called")
        clock = math.floor(time.monotonic() * 1e4)
        return {"own": self.calls, "clock": clock, "total": Counting.total}[kind[0]]


@pytest.fixture
def counting(device: Device) -> Counting:
    Counting.total = 0
    return Counting(Settings(), Context("counting", 0, device))


def test_state_of_the_component_changes_once(counting: Counting) -> None:
    assert answer_of(counting, "measure", ("own",), repeat_within=math.inf) == 1
    assert answer_of(counting, "measure", ("own",), repeat_within=math.inf) == 2
    assert Counting.total == 4


@pytest.mark.parametrize("kind", ["clock", "total"])
def test_another_answer_is_refused(counting: Counting, kind: str) -> None:
    """Two readings of the clock without a pause would be equal."""
    with pytest.raises(PluginError, match="another answer when the same call was repeated"):
        answer_of(counting, "measure", (kind,), repeat_within=math.inf)


def test_a_long_call_is_not_repeated(counting: Counting) -> None:
    assert answer_of(counting, "measure", ("total",), repeat_within=0.0) == 1


def test_messages_of_the_repetition_are_not_shown(
    counting: Counting, caplog: pytest.LogCaptureFixture
) -> None:
    answer_of(counting, "measure", ("own",), repeat_within=math.inf)
    assert caplog.messages == ["called"]
    assert logging.root.manager.disable == logging.NOTSET
