"""`stereogs doctor`."""

from __future__ import annotations

import pytest

from core_rasterizer import Device, open_device
from core_rasterizer.self_test import Verdict
from registry.cli import main

Capture = pytest.CaptureFixture[str]


def test_doctor(capsys: Capture) -> None:
    assert main(["doctor"]) == 0
    output = capsys.readouterr().out
    assert output.count("<- chosen") == 1
    assert "self-test: passed" in output


@pytest.mark.parametrize(
    ("told", "better", "line"),
    [
        ("skx", None, "kernels are built for skx, which the driver was told"),
        (None, "skx", "STEREOGS_CORRECT_CPU_NAME=1 has faster kernels built, for skx"),
        (None, None, None),
    ],
)
def test_doctor_names_the_processor_if_the_driver_does_not_know_it(
    told: str | None,
    better: str | None,
    line: str | None,
    capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Device, "built_for", told)
    monkeypatch.setattr(Device, "could_be_built_for", better)
    assert main(["doctor"]) == 0
    output = capsys.readouterr().out
    assert line in output if line else "kernels" not in output


def test_doctor_reports_a_failing_device_and_continues(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails_first(device: Device) -> Verdict:
        if device is devices[0]:
            raise RuntimeError("the driver is gone")
        return Verdict(0.0, 0.0)

    devices = [open_device(), open_device().as_variant("gpu")]
    monkeypatch.setattr("core_rasterizer.list_devices", lambda: devices)
    monkeypatch.setattr("core_rasterizer.self_test.self_test", fails_first)
    assert main(["doctor"]) == 1
    output = capsys.readouterr().out
    assert "FAILED: RuntimeError: the driver is gone" in output
    assert "passed" in output
