from __future__ import annotations

from pathlib import Path

import torch

from core_rasterizer import GaussianModel, load_ply, open_device
from registry.testing import tiny_scene
from stereogs_plugins.exporters.ply import PlyExporter, stereogs_register_exporters
from tests.stereogs_plugins.building import build, offered, some_gaussians


def test_is_offered_as_ply() -> None:
    assert offered(stereogs_register_exporters) == {"ply": PlyExporter}


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    gaussians = some_gaussians([0.1, 0.2, 0.3], [0.1, 0.5, 0.9])
    model = GaussianModel(gaussians, open_device())
    written = build(PlyExporter).export(model, tiny_scene(), tmp_path)
    assert written == [tmp_path / "scene.ply"]
    again = load_ply(written[0])
    for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh"):
        assert torch.equal(getattr(again, name), getattr(gaussians, name))
