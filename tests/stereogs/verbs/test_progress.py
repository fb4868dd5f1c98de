"""What `stereogs train` shows while it works: in a terminal, and in a pipe."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.host import SELECTION, main

ROOM = (
    "scene={use: procedural, width: 96, height: 72, test_views: 1}",
    "training.iterations=20",
)
STAGES = ["reading", "depth", "points", "completing", "training", "scoring", "files", "page"]
WIDTH = 60


@pytest.fixture(autouse=True)
def _installed_plugins(_no_installed_plugins: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(SELECTION)


def command(*options: str) -> list[str]:
    """Train a small room in twenty iterations; `options` are Python's own."""
    changes = [word for change in ROOM for word in ("--set", change)]
    train = ["-m", "stereogs", "train", "weightfree_quick", *changes, "--out", "run"]
    return [sys.executable, *options, *train]


def in_order(text: str) -> list[str]:
    """The names of stages at the start of lines, without repetitions."""
    found = [line.split(" ")[0] for line in text.splitlines()]
    names = [name for name in found if name in STAGES]
    return [name for name, before in zip(names, ["", *names], strict=False) if name != before]


def in_terminal(words: list[str], folder: Path) -> str:
    """Run a command in a pseudo-terminal of `WIDTH` columns and return all that it wrote."""
    import fcntl
    import pty
    import struct
    import termios

    control, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 24, WIDTH, 0, 0))
    environment = os.environ | {"TERM": "xterm"}
    started = subprocess.Popen(
        words, cwd=folder, stdin=terminal, stdout=terminal, stderr=terminal, env=environment
    )
    os.close(terminal)
    written = b""
    while True:
        try:
            part = os.read(control, 65536)
        except OSError:  # the other end is closed
            break
        written += part
    os.close(control)
    assert started.wait() == 0, written.decode()
    return written.decode()


@pytest.mark.proof
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_a_terminal_shows_a_bar_at_once_and_all_stages_in_order(tmp_path: Path) -> None:
    written = in_terminal(command("-X", "importtime"), tmp_path)
    torch = re.search(r"\| +torch\r", written)
    assert torch is not None
    assert "reading " in written[: torch.start()], "before the slow imports"
    shown = re.sub("import time:.*\r\n", "", written)
    plain = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown)
    lines = [line.rstrip() for line in re.split(r"[\r\n]+", plain)]
    ended = [line for line in lines if re.search(r"\d\.\d s( |$)", line) and "━" not in line]
    assert in_order("\n".join(ended)) == STAGES
    assert any(line.startswith("training  ━") or line.startswith("training  ─") for line in lines)
    bars = [line for line in lines if "━" in line or "─" in line]
    assert max(map(len, bars)) < WIDTH
    assert "test mean" in plain
    assert "train --hang-after" not in plain


@pytest.mark.proof
def test_a_pipe_gets_one_line_for_each_stage(tmp_path: Path) -> None:
    done = subprocess.run(
        command(),
        cwd=tmp_path,
        env=dict(os.environ),  # without COLUMNS, which readline may have set
        capture_output=True,
        text=True,
        check=True,
    )
    assert in_order(done.stdout) == STAGES
    assert "training  20/20" in done.stdout
    assert len(re.findall("^training", done.stdout, re.M)) == 2, "its start and its end"
    assert "\r" not in done.stdout
    assert "\x1b" not in done.stdout
    assert done.stderr == ""


def test_ctrl_c_during_the_report_says_how_to_continue(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from tests.host import HtmlReport

    monkeypatch.chdir(tmp_path)
    words = command()[3:]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs ignore it
    try:
        with monkeypatch.context() as patched:
            patched.setattr(HtmlReport, "write", lambda *_: signal.raise_signal(signal.SIGINT))
            assert main(words) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    told = capsys.readouterr().err
    assert "The trained scene is kept. `stereogs resume run` scores it" in told
    assert main(["resume", "run"]) == 0
    assert Path("run/report.html").is_file()
