from __future__ import annotations

import sys

import pytest

from registry import PluginError
from registry.runners import Runner
from stereogs_plugins.runners.ray_cluster import RayCluster
from stereogs_plugins.runners.submitit_jobs import Submitit
from tests.stereogs_plugins.building import build


@pytest.mark.parametrize(
    ("runner", "package", "extra"),
    [(RayCluster, "ray", "cluster"), (Submitit, "submitit", "slurm")],
)
def test_without_its_package_a_runner_says_how_to_install_it(
    monkeypatch: pytest.MonkeyPatch, runner: type[Runner], package: str, extra: str
) -> None:
    """There is no run yet that one could resume."""
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(PluginError, match=f"{package} cannot be imported") as caught:
        build(runner)
    assert caught.value.fix == f"pip install 'stereogs-plugins[{extra}]'"
