"""`stereogs doctor`."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from core_rasterizer.device import Description, Trial
from tests.host import main

Capture = pytest.CaptureFixture[str]
GOOD = Trial(None, 0.02, 1e-7, 1e-6, 1e-7)


def description(index: int, name: str) -> Description:
    return Description(index, name, "Platform", "gpu", "1.0", 8, 10**9)


@pytest.fixture
def two_devices(monkeypatch: pytest.MonkeyPatch) -> dict[str, Trial]:
    """Two listed devices; what their tests answer is for the test to set."""
    trials: dict[str, Trial] = {}
    devices = [description(0, "slow"), description(1, "fast")]
    monkeypatch.setattr("core_rasterizer.device.described", lambda environment=None: devices)
    monkeypatch.setattr("core_rasterizer.device.tried", lambda d, environment=None: trials[d.name])
    monkeypatch.delenv("STEREOGS_DEVICE", raising=False)
    return trials


def library(folder: Path, source: str) -> Path:
    """Compile a shared library."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler, which makes the broken driver")
    (folder / "broken.c").write_text(source)
    built = folder / "libbroken.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", built, folder / "broken.c"], check=True)
    return built


def test_doctor(capsys: Capture) -> None:
    assert main(["doctor"]) == 0
    output = capsys.readouterr().out
    assert output.count("<- chosen") == 1
    assert "self-test: passed" in output
    assert "training iteration" in output


@pytest.mark.parametrize("listed", [False, True])
@pytest.mark.parametrize("loaded", [False, True])
def test_doctor_says_how_to_register_an_nvidia_card(
    listed: bool,
    loaded: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    version = tmp_path / "version"
    if loaded:
        version.write_text("NVRM version: 580.159.04")
    name = "NVIDIA H100" if listed else "processor"
    monkeypatch.setattr("stereogs.verbs.doctor._NVIDIA", version)
    monkeypatch.setattr(
        "core_rasterizer.device.described", lambda environment=None: [description(0, name)]
    )
    monkeypatch.setattr("core_rasterizer.device.tried", lambda device, environment=None: GOOD)
    assert main(["doctor"]) == 0
    shown = "nvidia.icd" in capsys.readouterr().out
    assert shown == (loaded and not listed)


def test_doctor_marks_the_fastest_device(capsys: Capture, two_devices: dict[str, Trial]) -> None:
    two_devices.update(slow=GOOD, fast=Trial(None, 0.004, 1e-7, 1e-6, 1e-7))
    assert main(["doctor"]) == 0
    output = capsys.readouterr().out
    assert "fast (Platform, gpu, driver 1.0)  <- chosen" in output
    assert "training iteration: 4.0 ms" in output
    assert main(["doctor", "--device", "slow"]) == 0
    assert "slow (Platform, gpu, driver 1.0)  <- chosen" in capsys.readouterr().out


def test_doctor_reports_a_failing_device_and_continues(
    capsys: Capture, two_devices: dict[str, Trial]
) -> None:
    two_devices.update(slow=GOOD, fast=Trial("RuntimeError: the driver is gone"))
    assert main(["doctor"]) == 1
    output = capsys.readouterr().out
    assert "FAILED: RuntimeError: the driver is gone" in output
    assert "slow (Platform, gpu, driver 1.0)  <- chosen" in output


def test_doctor_reports_wrong_results(capsys: Capture, two_devices: dict[str, Trial]) -> None:
    two_devices.update(
        slow=GOOD, fast=Trial("it computes wrongly", image_error=0.5, gradient_error=float("nan"))
    )
    assert main(["doctor"]) == 1
    assert "FAILED: it computes wrongly, image error 5.0e-01" in capsys.readouterr().out


@pytest.mark.proof
def test_doctor_survives_a_driver_that_ends_the_process_when_it_is_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """The other drivers are tested; PoCL from pip is always there."""
    broken = library(
        tmp_path,
        "#include <stdlib.h>\n__attribute__((constructor)) static void load(void) { abort(); }",
    )
    vendors = tmp_path / "vendors"
    vendors.mkdir()
    (vendors / "broken.icd").write_text(f"{broken}\n")
    monkeypatch.setenv("OCL_ICD_VENDORS", str(vendors))
    monkeypatch.setattr("core_rasterizer.device.tried", lambda device, environment=None: GOOD)
    assert main(["doctor"]) == 1
    output = capsys.readouterr().out
    assert "listing the devices FAILED: the driver ended the process with signal 6" in output
    assert "broken.icd FAILED" in output
    assert "self-test: passed" in output


@pytest.mark.proof
def test_doctor_survives_a_driver_that_ends_the_process_when_it_compiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    broken = library(tmp_path, "#include <stdlib.h>\nint clBuildProgram(void) { abort(); }")
    monkeypatch.setenv("LD_PRELOAD", str(broken))
    assert main(["doctor"]) == 1
    assert "FAILED: the driver ended the process with signal 6" in capsys.readouterr().out
