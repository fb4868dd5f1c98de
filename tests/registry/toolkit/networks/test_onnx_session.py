"""A model runs on the requested provider, or the error explains why not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import onnxruntime
import pytest
import torch

from registry import PluginError
from registry.toolkit.networks import OnnxModel


def test_the_cpu_is_always_available(path: Path) -> None:
    assert OnnxModel(path, provider="cpu").provider == "cpu"


def test_a_provider_that_is_not_installed_is_refused(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("onnxruntime.get_available_providers", lambda: ["CPUExecutionProvider"])
    with pytest.raises(PluginError, match="'cuda' here") as caught:
        OnnxModel(path, provider="cuda")
    assert "choose one of cpu" in caught.value.fix


@pytest.fixture
def without_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    """Imitates an onnxruntime that was built for CUDA, without a driver."""

    start = onnxruntime.InferenceSession
    monkeypatch.setattr(
        "onnxruntime.get_available_providers",
        lambda: ["CUDAExecutionProvider", "CPUExecutionProvider"],
    )
    monkeypatch.setattr(
        "onnxruntime.InferenceSession",
        lambda content, options, providers, **more: start(
            content, options, providers=["CPUExecutionProvider"], **more
        ),
    )


@pytest.mark.usefixtures("without_driver")
def test_falling_back_to_the_cpu_is_an_error(path: Path) -> None:
    with pytest.raises(PluginError, match="could not start 'cuda'"):
        OnnxModel(path, provider="cuda")
    assert OnnxModel(path).provider == "cpu"


class Lost:
    """A session whose provider fails in its first run."""

    def __init__(self, inside: Any) -> None:
        self._inside = inside
        self._answers = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inside, name)

    def set_providers(self, *arguments: object) -> None:
        self._answers = True

    def run(self, *arguments: Any) -> Any:
        from onnxruntime.capi.onnxruntime_pybind11_state import EPFail

        if self._answers:
            return self._inside.run(*arguments)
        raise EPFail("the device is gone")


@pytest.mark.usefixtures("without_driver")
def test_no_other_provider_takes_over(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    network = OnnxModel(path)
    monkeypatch.setattr(network._session, "_sess", Lost(network._session._sess))
    with pytest.raises(PluginError, match="the device is gone"):
        network.run({"x": torch.zeros(2, 3), "y": torch.zeros(3)})
