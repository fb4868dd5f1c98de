"""Tests by the author of a plugin: the contract, and the purpose of the component."""

from pathlib import Path

import pytest
import torch
from stereogs_pointmap_prior import ScriptPointmap
from torch import Tensor
from torch.nn.functional import avg_pool2d, grid_sample

from core_rasterizer import open_device
from stereogs import api
from stereogs.testing import check

pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")


class Row(torch.nn.Module):
    """Plane sweep of cameras side by side, as wide as they are far from what fills the pictures."""

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        count, _, height, width = images.shape
        costs = [
            (self.moved(images, torch.full((count,), float(x))) - images[:1]).abs().mean((1, 2, 3))
            for x in range(-(width // 3), width // 3 + 1)
        ]
        # Of each view against view 0. The focal length is the width, and the unit the main depth.
        shifts = torch.stack(costs).argmin(dim=0).float() - width // 3
        poses = torch.eye(4).repeat(count, 1, 1)
        poses[:, 0, 3] = shifts / width
        points, logits = [], []
        for k in range(count):
            nearness = torch.linspace(0.5, 3, 26)
            warped = [self.moved(images, (shifts - shifts[k]) * near) for near in nearness]
            differences = [
                avg_pool2d((w - images[k]).abs().mean(1), 5, 1, 2).sum(0) for w in warped
            ]
            cost, best = (torch.stack(differences) / max(1, count - 1)).min(dim=0)
            depth = 1 / nearness[best]
            x = (torch.arange(width) + 0.5) / width - 0.5
            y = ((torch.arange(height) + 0.5 - height / 2) / width)[:, None]
            points.append(torch.stack([x * depth - poses[k, 0, 3], y * depth, depth], dim=2))
            logits.append(5 - 100 * cost)
        return torch.stack(points), poses, torch.stack(logits)

    def moved(self, images: Tensor, pixels: Tensor) -> Tensor:
        """Return images whose column x is column x + pixels of those given."""
        count, _, height, width = images.shape
        x = (2 * (torch.arange(width) + 0.5 + pixels[:, None]) / width - 1)[:, None]
        y = ((2 * torch.arange(height) + 1) / height - 1)[:, None]
        grid = torch.stack([x.expand(count, height, width), y.expand(count, height, width)], dim=3)
        return grid_sample(images, grid, padding_mode="border", align_corners=False)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    torch.jit.script(Row()).save(tmp_path / "row.pt")
    return tmp_path / "row.pt"


def photographs() -> tuple[list[Tensor], list[Tensor]]:
    """A wall and, at half its depth, a board, from three places; and the pixels that show the board."""
    random = torch.Generator().manual_seed(0)
    wall, board = (torch.rand(3, 48, 120, generator=random) for _ in range(2))
    images, shown = [], []
    for place in (0, 6, 12):
        columns = torch.arange(80) + 2 * place
        inside = ((columns > 40) & (columns < 70))[None] & (torch.arange(48)[:, None] < 24)
        picture = torch.where(inside, board[..., columns], wall[..., place : place + 80])
        images.append(picture.repeat_interleave(2, 1).repeat_interleave(2, 2).permute(1, 2, 0))
        shown.append(inside.repeat_interleave(2, 0).repeat_interleave(2, 1))
    return images, shown


def test_it_keeps_the_contract(model: Path) -> None:
    check(ScriptPointmap, model=model, size=(24, 16))


def test_it_finds_cameras_and_depth(model: Path) -> None:
    settings = ScriptPointmap.Settings(model=model, size=(80, 48))
    prior = ScriptPointmap(settings, api.Context("p", 0, open_device()))
    images, boards = photographs()
    found = prior.posed_depths(images, [None] * 3)
    right = [-float(view.world_to_camera[0, 3]) for view in found]
    assert right == pytest.approx([0, 6 / 80, 12 / 80])
    for view, board in zip(found, boards, strict=True):
        assert float(view.intrinsics[0, 0]) == pytest.approx(160, rel=1e-3)
        assert float(view.depth[board].median()) == pytest.approx(0.5)
        assert float(view.depth[~board].median()) == pytest.approx(1)
        assert float((view.depth[board] - 0.5).abs().lt(0.02).float().mean()) > 0.8
        assert float(view.confidence.median()) > 0.9


def test_more_photographs_than_it_accepts_are_refused(model: Path) -> None:
    settings = ScriptPointmap.Settings(model=model, max_views=2)
    prior = ScriptPointmap(settings, api.Context("p", 0, open_device()))
    with pytest.raises(api.PluginError, match="accepts 2 to 2 photographs, and got 3"):
        prior.posed_depths(photographs()[0], [None] * 3)
