"""The choice of a device, and what is remembered of its self-test."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from core_rasterizer import (
    Device,
    DeviceError,
    GaussianModel,
    list_devices,
    open_device,
    reference,
    self_test as self_test_module,
)
from core_rasterizer.device import Description, Trial, choose, drivers, trial
from core_rasterizer.device.profile import FEW

INFINITE = math.inf


@pytest.fixture(autouse=True)
def no_device_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("STEREOGS_DEVICE", raising=False)


def devices(*kinds: str) -> list[Description]:
    return [
        Description(i, f"device {i}", f"maker of a {kind}", kind, "2.0", 4, 10**9)
        for i, kind in enumerate(kinds)
    ]


def not_asked() -> list[float]:
    raise AssertionError("nothing needs to be timed")


def test_the_fastest_device_is_chosen_whatever_its_kind() -> None:
    assert choose(devices("gpu", "cpu"), None, lambda: [0.03, 0.02]) == 1
    assert choose(devices("cpu", "gpu"), None, lambda: [0.03, 0.02]) == 1


def test_a_device_that_fails_its_test_is_not_chosen() -> None:
    assert choose(devices("gpu", "cpu"), None, lambda: [INFINITE, 0.02]) == 1
    assert choose(devices("cpu", "gpu"), None, lambda: [INFINITE, INFINITE]) == 1


def test_nothing_is_timed_for_one_device_or_a_named_one(monkeypatch: pytest.MonkeyPatch) -> None:
    assert choose(devices("cpu"), None, not_asked) == 0
    assert choose(devices("gpu", "cpu"), "of a CPU", not_asked) == 1
    monkeypatch.setenv("STEREOGS_DEVICE", "device 1")
    assert choose(devices("gpu", "cpu"), None, not_asked) == 1
    assert choose(devices("gpu", "cpu"), "2.0", not_asked) == 0, "a driver's version"


@pytest.mark.parametrize(
    ("names", "message", "fix"),
    [
        ([], "no OpenCL platform was found", "install a driver"),
        (["Portable Computing Language"], "its cache cannot be written", "set POCL_CACHE_DIR"),
        (["Maker's"], "the installed OpenCL drivers list no device: Maker's", "update the driver"),
    ],
)
def test_without_devices_the_error_says_why(
    names: list[str], message: str, fix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path / "file" / "below"))
    found = [SimpleNamespace(name=name) for name in names]
    monkeypatch.setattr(drivers, "platforms", lambda: found)
    with pytest.raises(DeviceError, match=message) as caught:
        choose([], None, not_asked)
    assert caught.value.fix.startswith(fix)


UNWRITABLE = """
import os
from core_rasterizer import list_devices
print(len(list_devices()), os.path.isdir(os.environ["POCL_CACHE_DIR"]), os.environ["PYOPENCL_NO_CACHE"])
"""


def test_without_a_writable_home_kernels_are_compiled_in_a_temporary_folder(tmp_path: Path) -> None:
    if not any("Portable" in device.platform for device in list_devices()):
        pytest.skip("PoCL is not installed")
    (tmp_path / "home").touch()
    kept = {k: v for k, v in os.environ.items() if k not in {"POCL_CACHE_DIR", "XDG_CACHE_HOME"}}
    environment = {**kept, "HOME": str(tmp_path / "home"), "TMPDIR": str(tmp_path)}
    command = [sys.executable, "-c", UNWRITABLE]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    devices, exists, no_cache = done.stdout.split()
    assert (int(devices) > 0, exists, no_cache) == (True, "True", "1")
    assert "set POCL_CACHE_DIR" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["home"], "removed at the end"


def test_a_full_disk_is_named_before_the_compiler_ends_the_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=10**5))
    assert drivers.problem_of(tmp_path) == "has 0.1 MB of free space"


def test_a_trial_is_remembered_for_each_device_and_driver(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path))
    asked = []

    def answer(arguments: list[str], environment: object) -> dict[str, object] | str:
        asked.append(arguments)
        return "it died" if arguments == ["1"] else {"failure": None, "seconds": 0.5}

    monkeypatch.setattr(trial, "_child", answer)
    both = devices("gpu", "cpu")
    assert trial.seconds_of(both) == [0.5, INFINITE]
    assert trial.seconds_of(both) == [0.5, INFINITE]
    assert asked == [["0"], ["1"]]
    newer = Description(**{**vars(both[0]), "driver": "2.1"})
    trial.seconds_of([newer])
    assert len(asked) == 3
    (tmp_path / "devices.json").write_text("{ damaged")
    assert trial.seconds_of(both) == [0.5, INFINITE]


@pytest.mark.proof
def test_a_real_trial_in_a_child_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path))
    device = list_devices()[0].describe(0)
    found = trial.tried(device)
    assert found.failure is None
    assert 0 < found.seconds < 60
    (entry,) = json.loads((tmp_path / "devices.json").read_text()).values()
    assert entry["seconds"] == found.seconds


def test_several_devices_are_timed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """open_device with two devices; the second is as the first, with GPU kernels."""
    first = list_devices()[0]
    pair = (first, first.as_variant("gpu"))
    monkeypatch.setattr("core_rasterizer.device.device._devices", lambda: pair)
    monkeypatch.setattr("core_rasterizer.device.device.seconds_of", lambda devices: [2.0, 1.0])
    from core_rasterizer.device.device import _seconds

    _seconds.cache_clear()
    try:
        assert open_device() is pair[1]
    finally:
        _seconds.cache_clear()


def test_the_self_test_reaches_large_chunks_and_boxes_over_64_tiles(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts, boxes = [], []
    original = GaussianModel.render

    def render(self: GaussianModel, *arguments: object, **named: object) -> object:
        rendering = original(self, *arguments, **named)  # type: ignore[arg-type]
        counts.append(self.count)
        coverage: Any = rendering.coverage
        boxes.append(int(coverage._tiles_covered.read(0, self.count).max()))
        return rendering

    monkeypatch.setattr(GaussianModel, "render", render)
    verdict = self_test_module.self_test(device)
    assert verdict.passed
    assert verdict.depth_error < 1e-6
    assert max(counts) > FEW
    assert max(boxes) > 64


def test_rounding_decides_no_pixel_of_the_self_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pixel beside a threshold failed a correct GPU, whose arithmetic rounds differently."""

    def images(factor: float) -> list[Tensor]:
        for threshold in ("ALPHA_MIN", "TRANSMITTANCE_MIN"):
            monkeypatch.setattr(reference, threshold, factor * getattr(reference, threshold))
        return [
            reference.render(
                gaussians.means.double(),
                gaussians.quaternions.double(),
                gaussians.log_scales.double().exp(),
                gaussians.opacity_logits.double().sigmoid(),
                gaussians.sh.double(),
                camera,
            ).rgb
            for gaussians, camera in self_test_module._scenes()
        ]

    as_they_are, lower = images(1), images(1 - 1e-4)
    for image, *others in zip(as_they_are, lower, images((1 + 1e-4) / (1 - 1e-4)), strict=True):
        assert all(torch.equal(image, other) for other in others)


def test_a_wrong_result_fails_the_self_test(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = GaussianModel.gradient
    monkeypatch.setattr(
        GaussianModel, "gradient", lambda self, name: torch.zeros_like(original(self, name))
    )
    result = self_test_module.trial(device)
    errors: dict[str, Any] = _errors(result)
    assert result == Trial("it computes wrongly", **errors)


def _errors(result: Trial) -> dict[str, object]:
    names = ("image_error", "gradient_error", "depth_error")
    return {name: getattr(result, name) for name in names}
