from __future__ import annotations

import sys

import pytest

from registry import PluginError
from stereogs_plugins.runners.ray_cluster import RayCluster
from tests.stereogs_plugins.building import build


def test_without_ray_it_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """There is no run yet that one could resume."""
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(PluginError, match="ray cannot be imported") as caught:
        build(RayCluster)
    assert caught.value.fix == "pip install 'stereogs-plugins[cluster]'"
