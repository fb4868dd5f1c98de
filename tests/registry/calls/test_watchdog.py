from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass

import pytest

from registry import PluginError
from registry.calls.watchdog import EXPECTED, EXPECTED_IN_LOOP, PATIENCE, Hang, Watchdog
from tests.host import Stages


class Clock:
    """A clock that tests turn forward."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Bench:
    """A watchdog without a thread; its warnings go to the log."""

    clock: Clock
    stages: Stages
    dog: Watchdog

    def after(self, seconds: float) -> None:
        """Look once a second, as the thread does."""
        for _ in range(int(seconds)):
            self.clock.now += 1
            self.dog.look()


@pytest.fixture
def bench() -> Bench:
    clock = Clock()
    dog = Watchdog(look_every=None, clock=clock)
    return Bench(clock, Stages(clock, dog), dog)


def quick() -> Watchdog:
    return Watchdog(look_every=0.01)


def stubborn() -> None:
    """Ignore every `Exception`."""
    while True:
        try:
            time.sleep(60)
        except Exception:
            pytest.fail("a plugin's `except Exception` must not stop it")


def test_a_silent_call_causes_one_warning_after_ten_times_the_expected_time(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    bench.stages.report("points")
    with bench.dog.watching("initializer 'slow' at p.yaml:4"):
        bench.after(PATIENCE * EXPECTED - 1)
        assert not caplog.messages
        bench.after(5000)
    (told,) = caplog.messages
    assert told.startswith("initializer 'slow' at p.yaml:4 has been running for 600 s")
    assert "--" not in told, "no option of another command"


def test_an_iteration_is_expected_to_take_less(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    with bench.dog.watching("loss", 20):
        bench.after(PATIENCE * EXPECTED_IN_LOOP)
    (told,) = caplog.messages
    assert told.startswith("loss, iteration 20 has been running for 60 s")
    assert "stereogs resume RUN" in told


def test_no_warning_while_progress_is_reported(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    with bench.dog.watching("scene loader"):
        for done in range(66):
            bench.stages.report("matching", done, 66)
            bench.after(100)
        assert not caplog.messages, "not in two hours"
        bench.after(899)
        assert not caplog.messages, "ten times the longest step"
        bench.after(1)
    assert len(caplog.messages) == 1


def test_earlier_calls_tell_how_long_the_next_may_take(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    with bench.dog.watching("metric"):
        bench.after(200)
    with bench.dog.watching("metric"):
        bench.after(1999)
        assert not caplog.messages
        bench.after(1)
        assert len(caplog.messages) == 1


def test_one_warning_in_each_stage(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    for count, stage in enumerate(("depth", "points"), 1):
        bench.stages.report(stage)
        for who in "abc":
            with bench.dog.watching(f"{who} of {stage}"), bench.dog.watching(f"prior of {stage}"):
                bench.after(10_000)
        assert len(caplog.messages) == count


def test_short_inner_calls_of_a_long_call_cause_no_warning(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    with bench.dog.watching("initializer"):
        for _ in range(120):
            with bench.dog.watching("prior"):
                bench.after(10)
    (told,) = caplog.messages
    assert told.startswith("initializer"), "no prior took long"


def test_calls_of_other_threads_cause_warnings(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    entered, end = threading.Event(), threading.Event()

    def work() -> None:
        with bench.dog.ending(0.01), bench.dog.watching("elsewhere"):
            entered.set()
            end.wait()

    thread = threading.Thread(target=work)
    thread.start()
    entered.wait()
    bench.after(600)
    end.set()
    thread.join()
    assert caplog.messages[0].startswith("elsewhere")


def test_a_hang_is_ended_with_an_error() -> None:
    dog, before = quick(), signal.getsignal(signal.SIGVTALRM)
    begin = time.monotonic()
    with pytest.raises(Hang) as caught, dog.ending(0.1), dog.watching("loss", 3):
        stubborn()
    assert time.monotonic() - begin < 10
    error = caught.value.explained()
    assert isinstance(error, PluginError)
    assert error.what == "no answer came within 0.1 s"
    assert error.where == "loss, iteration 3"
    assert signal.getsignal(signal.SIGVTALRM) == before


def test_short_inner_calls_do_not_hide_a_hang() -> None:
    dog = quick()

    def call_forever() -> None:
        while True:
            with dog.watching("prior"):
                time.sleep(0.01)

    with pytest.raises(Hang) as caught, dog.ending(0.5), dog.watching("initializer"):
        call_forever()
    assert caught.value.call.who == "initializer"


def test_calls_within_the_limit_are_not_ended() -> None:
    dog = quick()
    with dog.ending(None), dog.watching("patient"):
        time.sleep(0.1)
    with dog.ending(5), dog.watching("patient"):
        time.sleep(0.1)


LATE = """
import time
from registry.calls.watchdog import Hang, Watchdog
dog = Watchdog(look_every=0.1)
try:
    with dog.ending(0.2):
        from core_rasterizer import open_device
        open_device()
        with dog.watching("loss of p.yaml:4", 3):
            time.sleep(60)
except Hang as hang:
    print(hang.explained())
"""


def test_libraries_of_the_device_do_not_use_the_signal() -> None:
    done = subprocess.run([sys.executable, "-c", LATE], capture_output=True, text=True, timeout=200)
    assert "no answer came within 0.2 s" in done.stdout
    assert done.returncode == 0


STUBBORN = """
import time
from registry.calls.watchdog import Hang, Watchdog
dog = Watchdog(look_every=0.01, grace=0.1)
with dog.ending(0.05), dog.watching("loss of p.yaml:4", 3):
    while True:
        try:
            time.sleep(60)
        except Hang:
            pass
"""


def test_a_call_that_ignores_the_interrupt_ends_the_process() -> None:
    done = subprocess.run(
        [sys.executable, "-c", STUBBORN], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 2
    assert "loss of p.yaml:4, iteration 3" in done.stderr
    assert "stereogs resume RUN" in done.stderr
