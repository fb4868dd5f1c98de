"""One process uses a folder at a time; the lock ends with its process."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from registry import RunError
from registry.system.lock import locked
from tests.host import RunFolder

HOLD = """
import sys, time
from pathlib import Path
from registry.system.lock import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""


AS_ON_WINDOWS = """
import fcntl, os, sys, types
import registry
def locking(descriptor, mode, bytes):
    fcntl.lockf(descriptor, mode, bytes, 0, os.SEEK_CUR)
sys.modules["msvcrt"] = types.SimpleNamespace(
    locking=locking, LK_NBLCK=fcntl.LOCK_EX | fcntl.LOCK_NB, LK_UNLCK=fcntl.LOCK_UN
)
sys.modules.pop("registry.system.lock", None)
sys.platform = "win32"
"""


@contextmanager
def other_process(folder: Path, first: str = "") -> Iterator[subprocess.Popen[str]]:
    """Lock the folder in another process, which is killed afterwards.

    Args:
        first: code that it runs before.
    """
    command = [sys.executable, "-c", first + HOLD, str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "locked\n"
        yield process
        process.kill()


def test_a_second_process_is_refused_until_the_first_is_killed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run = RunFolder(tmp_path)
    with other_process(tmp_path) as other:
        with pytest.raises(RunError, match=f"in use by another process, number {other.pid}"):
            run.locked().__enter__()
        other.kill()
        other.wait()
        with caplog.at_level(logging.WARNING), run.locked():
            pass
    assert f"process {other.pid} was killed" in caplog.text
    caplog.clear()
    with run.locked():
        pass
    assert caplog.text == ""


@pytest.mark.skipif(os.name != "posix", reason="locks with the functions of POSIX")
def test_windows_has_a_lock_of_its_own(tmp_path: Path) -> None:
    with other_process(tmp_path, AS_ON_WINDOWS) as other:
        second = subprocess.run(
            [sys.executable, "-c", AS_ON_WINDOWS + HOLD, str(tmp_path)],
            capture_output=True,
            text=True,
            timeout=50,
        )
        assert f"in use by another process, number {other.pid}" in second.stderr
    with other_process(tmp_path, AS_ON_WINDOWS):
        pass


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_child_does_not_keep_the_lock(tmp_path: Path) -> None:
    with locked(tmp_path):
        child = os.fork()
        if not child:
            signal.pause()
    try:
        with locked(tmp_path):
            pass
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def test_an_error_does_not_count_as_a_kill(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), locked(tmp_path):
        raise ZeroDivisionError
    with locked(tmp_path) as lock:
        assert lock.killed is None


def test_a_folder_that_cannot_be_written_is_explained(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="folder cannot be written") as caught:
        locked(tmp_path / "none").__enter__()
    assert str(tmp_path) in caught.value.where
