"""Model files are ONNX models with the expected hash."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numpy as np
import pytest

from registry import PluginError
from registry.toolkit.networks import OnnxModel
from tests.registry.toolkit.networks.conftest import addition, saved


def test_the_hash_of_the_file_is_checked(path: Path) -> None:
    expected = hashlib.sha256(path.read_bytes()).hexdigest()
    model = OnnxModel(str(path), expected.upper())
    assert model.sha256 == expected
    assert expected in model.fingerprint
    assert model.provider in model.fingerprint
    with pytest.raises(PluginError) as caught:
        OnnxModel(path, "0" * 64)
    assert expected in caught.value.what
    assert "0" * 64 in caught.value.what
    assert caught.value.where == str(path)


def test_a_missing_file_is_explained(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match="cannot be read") as caught:
        OnnxModel(tmp_path / "none.onnx")
    assert caught.value.what.endswith("cannot be read: No such file or directory")
    assert "`stereogs models get NAME`" in caught.value.fix
    with pytest.raises(PluginError, match="cannot be read"):
        OnnxModel(tmp_path)


def test_pipes_devices_and_large_files_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "pipe.onnx")
    for path in (tmp_path / "pipe.onnx", Path("/dev/zero")):
        with pytest.raises(PluginError, match="it is not a regular file"):
            OnnxModel(path)
    monkeypatch.setattr("registry.toolkit.networks.model_file.LARGEST", 1000)
    large = tmp_path / "large.onnx"
    large.write_bytes(bytes(1001))
    with pytest.raises(PluginError, match="it has 1,001 bytes, more than 1,000"):
        OnnxModel(large)


@pytest.mark.parametrize("content", [b"", b"not a network", b"\x08\x0a" * 40])
def test_a_file_of_another_kind_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "model.onnx"
    path.write_bytes(content)
    with pytest.raises(PluginError, match="cannot load the ONNX model") as caught:
        OnnxModel(path)
    assert caught.value.where == str(path)


def test_names_in_a_file_are_not_printed(
    path: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path.write_bytes(path.read_bytes().replace(b"\x22\x03Add", b"\x22\x03A\xf3\x1b"))
    with pytest.raises(PluginError, match="cannot load the ONNX model"):
        OnnxModel(path, provider="cpu")
    model = addition()
    model.graph.node[2].name = "\x1b[2J"
    network = OnnxModel(saved(tmp_path, model), provider="cpu")
    with pytest.raises(PluginError, match="the model failed"):
        network._answers({"x": np.zeros((2, 3), np.float32), "y": np.zeros(7, np.float32)})
    printed = capfd.readouterr()
    assert printed.out + printed.err == ""


def test_a_truncated_file_is_refused(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(PluginError, match="cannot load the ONNX model"):
        OnnxModel(path)
