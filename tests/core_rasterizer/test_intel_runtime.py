"""The runtime that pip installs is named to the loader; one that is not there, or not wanted, is not."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from core_rasterizer.device import drivers
from core_rasterizer.device.drivers import _offer_intel_runtime, intel_library

VARIABLES = ("OCL_ICD_VENDORS", "OCL_ICD_FILENAMES")


@pytest.fixture
def library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An environment in which pip recorded the runtime, and a system with another driver."""
    site = tmp_path / "lib" / "site-packages"
    record = site / "intel_opencl_rt-2026.2.0.dist-info" / "RECORD"
    record.parent.mkdir(parents=True)
    record.write_text("../cl.cfg,,\n../libintelocl.so,,\n", "utf-8")
    (record.parent / "METADATA").write_text("Name: intel-opencl-rt\nVersion: 2026.2.0\n", "utf-8")
    system = tmp_path / "vendors"
    system.mkdir()
    (system / "other.icd").write_text("libother.so\n", "utf-8")
    monkeypatch.setattr(drivers, "_SYSTEM", system)
    monkeypatch.setattr("sys.path", [str(site)])
    for name in VARIABLES:
        monkeypatch.setenv(name, "")
    file = tmp_path / "lib" / "libintelocl.so"
    file.touch()
    return file


def test_it_is_named_beside_the_drivers_of_the_system(library: Path) -> None:
    _offer_intel_runtime()
    files = sorted(Path(os.environ["OCL_ICD_VENDORS"]).iterdir())
    texts = [file.read_text("utf-8") for file in files]
    assert texts == [f"{library}\n", "libother.so\n"]
    assert {file.suffix for file in files} == {".icd"}


def test_a_choice_of_the_user_stays(library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert intel_library() == library
    monkeypatch.setenv("OCL_ICD_VENDORS", "/mine")
    _offer_intel_runtime()
    assert os.environ["OCL_ICD_VENDORS"] == "/mine"


@pytest.mark.parametrize("left", ["the record", "nothing"])
def test_without_it_nothing_is_set(
    left: str, library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library.unlink()
    if left == "nothing":
        monkeypatch.setattr("sys.path", [])
    _offer_intel_runtime()
    assert os.environ["OCL_ICD_VENDORS"] == ""


def test_windows_has_another_variable(library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "before")
    monkeypatch.setattr("sys.platform", "win32")
    _offer_intel_runtime()
    assert os.environ["OCL_ICD_FILENAMES"] == str(library)
    assert os.environ["PATH"] == os.pathsep.join((str(library.parent), "before"))
    assert os.environ["OCL_ICD_VENDORS"] == ""
