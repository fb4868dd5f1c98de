"""Tests by the author of a plugin: the contract, and the purpose of the component."""

from pathlib import Path

import pytest
import torch
from stereogs_metric_prior import ScriptMetric
from torch import Tensor

from core_rasterizer import Camera, open_device
from stereogs import api
from stereogs.testing import check

pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")
LIMIT = 8.0
"""Metres that the flash reaches."""


class Flash(torch.nn.Module):
    """A photograph by flash: the light of a white surface falls with the square of its depth."""

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        depth = image.mean(dim=1).clamp(min=1e-6).rsqrt()
        return depth, torch.full((1,), 0.8 * image.shape[3]), 8.0 - depth


@pytest.fixture
def model(tmp_path: Path) -> Path:
    torch.jit.script(Flash()).save(tmp_path / "flash.pt")
    return tmp_path / "flash.pt"


def test_it_keeps_the_contract(model: Path) -> None:
    check(ScriptMetric, model=model)


def test_it_finds_metres_where_the_flash_reaches(model: Path) -> None:
    prior = ScriptMetric(ScriptMetric.Settings(model=model), api.Context("p", 0, open_device()))
    truth = torch.linspace(1.5, 12, 40).expand(30, 40)
    view = api.View("wall", Camera(torch.eye(4), 32, 32, 20, 15, 40, 30), flash(truth))
    found = prior.depth_of(view.for_training())
    assert found.ambiguity == "metric"
    assert found.valid is not None
    assert torch.equal(found.valid, truth < LIMIT)
    assert torch.allclose(found.farness[found.valid], truth[found.valid], rtol=1e-3)
    assert found.intrinsics is not None
    assert float(found.intrinsics[0, 0]) == 32


def flash(depth: Tensor) -> Tensor:
    """The photograph `[H, W, 3]` of a white surface at a depth of 1 m or more."""
    return (1 / depth.square())[..., None].expand(-1, -1, 3).contiguous()
