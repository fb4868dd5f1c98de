"""Model files for pipelines that name some: real graphs, as small as they can be."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.stereogs_plugins.priors.graphs import Graph


@pytest.fixture(scope="session")
def small_models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder like that of STEREOGS_MODELS. Monocular depth: the lighter, the nearer."""
    folder = tmp_path_factory.mktemp("models")
    (folder / "fastdepth_nyu").mkdir()
    graph = Graph()
    image = graph.input("image", (1, 3, "H", "W"))
    axes = graph.constant([1], int)
    mean = graph("ReduceSum", image, axes, keepdims=1)
    graph.output("inverse_depth", mean, (1, 1, "H", "W"))
    graph.save(folder / "fastdepth_nyu" / "fastdepth_nyu.onnx")
    return folder
