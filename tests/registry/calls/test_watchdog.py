from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time

import pytest

from registry import PluginError
from registry.calls.watchdog import Hang, Watchdog


def quick() -> Watchdog:
    return Watchdog(tell_after=0.4, look_every=0.01)


def stubborn() -> None:
    """What no exception of the usual kind ends."""
    while True:
        try:
            time.sleep(60)
        except Exception:
            pytest.fail("a plugin's `except Exception` must not stop it")


def test_a_long_call_is_told_of_by_name(caplog: pytest.LogCaptureFixture) -> None:
    dog = quick()
    with dog.watching("regularizer 'slow' at p.yaml:4", 20):
        time.sleep(1)
    told = [
        m for m in caplog.messages if m.startswith("regularizer 'slow' at p.yaml:4, iteration 20")
    ]
    assert 2 <= len(told) <= 6, "again whenever the time has doubled"
    assert "stereogs resume RUN" in told[0]
    caplog.clear()
    for _ in range(10):
        with dog.watching("quick"):
            time.sleep(0.05)
    assert not caplog.messages


def test_who_is_asked_by_somebody_is_told_of_and_then_forgotten(
    caplog: pytest.LogCaptureFixture,
) -> None:
    dog = quick()
    with dog.watching("initializer"):
        for _ in range(12):
            with dog.watching("prior"):
                time.sleep(0.05)
    assert caplog.messages
    assert all(m.startswith("initializer") for m in caplog.messages), "no prior took long"


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


def test_many_short_calls_of_one_that_hangs_do_not_hide_it() -> None:
    dog = quick()

    def ask_for_ever() -> None:
        while True:
            with dog.watching("prior"):
                time.sleep(0.01)

    with pytest.raises(Hang) as caught, dog.ending(0.5), dog.watching("initializer"):
        ask_for_ever()
    assert caught.value.call.who == "initializer"


def test_nothing_is_ended_that_nobody_wants_to_end() -> None:
    dog = quick()
    with dog.ending(None), dog.watching("patient"):
        time.sleep(0.1)
    with dog.ending(5), dog.watching("patient"):
        time.sleep(0.1)


def test_other_threads_are_watched_and_not_ended(caplog: pytest.LogCaptureFixture) -> None:
    dog = quick()

    def work() -> None:
        with dog.ending(0.01), dog.watching("elsewhere"):
            time.sleep(0.6)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert caplog.messages[0].startswith("elsewhere")


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


def test_libraries_that_the_device_brings_along_do_not_take_the_signal() -> None:
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


def test_what_does_not_heed_is_ended_with_the_process() -> None:
    done = subprocess.run(
        [sys.executable, "-c", STUBBORN], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 2
    assert "loss of p.yaml:4, iteration 3" in done.stderr
    assert "stereogs resume RUN" in done.stderr
