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
    return Watchdog(warn_after=0.4, look_every=0.01)


def stubborn() -> None:
    """Ignore every `Exception`."""
    while True:
        try:
            time.sleep(60)
        except Exception:
            pytest.fail("a plugin's `except Exception` must not stop it")


def test_a_long_call_causes_warnings_with_its_name(caplog: pytest.LogCaptureFixture) -> None:
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


def test_short_inner_calls_of_a_long_call_cause_no_warning(
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


def test_calls_of_other_threads_cause_warnings_and_are_not_ended(
    caplog: pytest.LogCaptureFixture,
) -> None:
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
