from __future__ import annotations

import sys
from pathlib import Path

import pytest

import stereogs
from registry import PluginError
from registry.testing import tiny_scene
from tests.stereogs_plugins.observers.heard import pipeline


def hide(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("torch.utils.tensorboard", "wandb", "mlflow", "rerun"):
        monkeypatch.setitem(sys.modules, module, None)


def test_a_run_that_leaves_no_files_needs_none(monkeypatch: pytest.MonkeyPatch) -> None:
    hide(monkeypatch)
    names = ["tensorboard", "wandb", "mlflow", "rerun"]
    told = pipeline("", observers=names)
    assert stereogs.train(told, scene=tiny_scene(), progress=False).finished


@pytest.mark.parametrize("name", ["tensorboard", "wandb", "mlflow", "rerun"])
def test_without_its_package_it_says_how_to_install_it(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hide(monkeypatch)
    with pytest.raises(PluginError, match="cannot be imported") as caught:
        stereogs.train(pipeline(name), scene=tiny_scene(), out=tmp_path / "run", progress=False)
    assert f"pip install 'stereogs-plugins[{name}]'" in caught.value.fix
    assert f"observer '{name}'" in caught.value.where
