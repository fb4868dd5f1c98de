"""Damaged files cause no crash, no hang, no invalid data, and no forbidden action.

`make fuzz` reads 100,000 files per format.
"""

from __future__ import annotations

import logging
import os
import pickle
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from core_rasterizer import ExplainedError
from tests.fuzzing.__main__ import State, run, shares
from tests.fuzzing.crashing import crashing
from tests.fuzzing.damage import damage
from tests.fuzzing.formats import TARGETS
from tests.fuzzing.fuzz import folder_for, fuzz
from tests.fuzzing.guard import Forbidden, watched
from tests.fuzzing.target import Target

FILES = 500
SOON = 0.02
"""CPU seconds that a reader may take in tests."""


@pytest.fixture(autouse=True)
def _restored_log_level() -> Iterator[None]:
    """Restore the log level, which a target changes."""
    cache = logging.getLogger("registry.toolkit.cache.entries")
    level = cache.level
    yield
    cache.setLevel(level)


@pytest.mark.proof
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", TARGETS)
def test_damaged_files_are_explained_or_harmless(name: str, tmp_path: Path) -> None:
    tally = fuzz(TARGETS[name](folder_for(name, tmp_path)), range(FILES))
    assert tally.failures == {}
    assert tally.refused > FILES / 4  # some damage is detected


def test_the_same_number_does_the_same_damage() -> None:
    data = bytes(range(256)) * 4
    for file in ("a.npy", "b.json"):
        assert damage(data, file, random.Random(3)) == damage(data, file, random.Random(3))
        assert any(damage(data, file, random.Random(k)) != data for k in range(3))


class Careless(Target):
    """A reader whose fault depends on the first byte; fuzzing must find all faults."""

    name = "careless"

    def __init__(self, folder: Path) -> None:
        self.held: list[bytearray] = []
        super().__init__(folder)

    def write(self) -> tuple[str, ...]:
        """Write one byte."""
        (self.folder / "a").write_bytes(bytes(1))
        return ("a",)

    def read(self) -> None:
        """Act as the first byte specifies."""
        first = (self.folder / "a").read_bytes()[:1]
        if not first:
            raise ExplainedError("it is empty")
        if first[0] in (1, 2):
            raise ValueError("a traceback")
        assert first[0] != 4, "accepted and wrong"
        if first[0] == 8:
            end = time.process_time() + 2 * SOON
            while time.process_time() < end:
                pass
        if first[0] in (16, 32):
            (self.folder.parent.parent / "outside").touch()
        if first[0] in (64, 128):
            self.held.append(bytearray(100_000_000))


def test_every_fault_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.fuzzing.fuzz.SLOWEST", SOON)
    tally = fuzz(Careless(folder_for("careless", tmp_path)), range(300))
    found = " ".join(tally.failures.values())
    faults = (
        "a traceback",
        "accepted and wrong",
        "s of a core",
        "opened for writing",
        "memory grew",
    )
    for fault in faults:
        assert fault in found
    assert tally.accepted > 0
    assert tally.refused > 0
    assert not (tmp_path / "outside").exists()


def test_forbidden_actions_are_detected(tmp_path: Path) -> None:
    for act in (
        lambda: subprocess.run([sys.executable, "-c", ""], check=True),
        lambda: os.system("true"),
        lambda: pickle.loads(pickle.dumps(Careless)),
        lambda: (tmp_path.parent / "a").write_text(""),
    ):
        with pytest.raises(Forbidden), watched(tmp_path):
            act()
    with watched(tmp_path):
        (tmp_path / "a").write_text("")


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of a run whose readers import quickly and crash at number 3."""
    monkeypatch.setattr("tests.fuzzing.__main__.work", crashing)
    return tmp_path / "state"


def test_a_crash_is_isolated_and_a_run_continues(
    state: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(State(state), [("a", 0, 10), ("b", 10, 20)], 20)
    said = capsys.readouterr().out
    assert "FAILED  a 3: the process ended" in said
    assert "100 %  20 of 20" in said
    assert [path.name for path in state.glob("failed-*")] == ["failed-a-3.txt"]
    found = State(state).done
    assert found.pop(("a", 3, 4)) == (0, 0, 1)
    # The other process may have been ended during its share, which is then split.
    assert all(counts == (stop - first, 0, 0) for (_, first, stop), counts in found.items())
    read = sorted((name, number) for name, first, stop in found for number in range(first, stop))
    wanted = [("a", number) for number in range(10) if number != 3]
    assert read == wanted + [("b", number) for number in range(10, 20)]


def test_formats_take_turns() -> None:
    assert list(shares(["a", "b"], 1500)) == [
        ("a", 0, 1000),
        ("b", 0, 1000),
        ("a", 1000, 1500),
        ("b", 1000, 1500),
    ]
