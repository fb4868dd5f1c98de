"""Fetching of runtimes, the simulator's report of a race, and what is printed where neither can be had."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from core_rasterizer.device import program
from tests.runtimes import __main__ as command, fetching, race_scenes, races
from tests.runtimes.catalog import Runtime
from tests.runtimes.fetching import Unavailable, unpacked


@pytest.fixture
def offline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without apt-get, and an empty folder for what is fetched."""
    monkeypatch.setattr(fetching, "FOLDER", tmp_path / "runtimes")
    monkeypatch.setenv("PATH", str(tmp_path))
    return tmp_path / "runtimes"


def test_what_cannot_be_fetched_leaves_no_folder(offline: Path) -> None:
    with pytest.raises(Unavailable, match="apt-get"):
        unpacked("some", debian=("some-package",))
    assert not (offline / "some").exists()


def test_a_runtime_that_cannot_be_fetched_is_skipped_by_name(
    offline: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fetch() -> dict[str, str]:
        unpacked("some", debian=("some-package",))
        return {}

    monkeypatch.setattr(command, "RUNTIMES", (Runtime("Some runtime", "GPU", "some", fetch),))
    monkeypatch.setattr("sys.argv", ["runtimes"])
    assert command.main() == 0
    assert "Some runtime: skipped, it cannot be fetched: apt-get" in capsys.readouterr().out


def test_races_are_skipped_without_the_simulator(
    offline: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert races.main() == 0
    assert "skipped, oclgrind cannot be fetched: apt-get" in capsys.readouterr().out


def test_libraries_of_a_wheel_are_unpacked(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "some.whl", "w") as wheel:
        wheel.writestr("some-1.0.data/data/lib/libsome.so", "library")
        wheel.writestr("some-1.0.dist-info/METADATA", "text")
    fetching._unpack_libraries(tmp_path / "some.whl", tmp_path / "lib")
    assert [file.name for file in (tmp_path / "lib").iterdir()] == ["libsome.so"]


def test_one_barrier_is_removed(monkeypatch: pytest.MonkeyPatch) -> None:
    original = program._source
    monkeypatch.setattr(program, "_source", original)  # restored afterwards
    race_scenes.without_barrier("raster/raster_gpu", 3)
    before, after = (source("raster/raster_gpu") for source in (original, program._source))
    assert after.count("barrier(") == before.count("barrier(") - 1
    assert program._source("raster/scan") == original("raster/scan")


@pytest.mark.proof
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("barrier", ["raster/raster_gpu:3", "raster/raster_gpu:5"])
def test_a_removed_barrier_is_reported_as_a_race(barrier: str) -> None:
    try:
        found = races.reports("gpu", "engine", barrier)
    except Unavailable as reason:
        pytest.skip(f"oclgrind cannot be fetched: {reason}")
    assert "data race" in found
