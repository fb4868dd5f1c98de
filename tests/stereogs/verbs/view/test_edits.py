"""Selecting, deleting, undoing and saving Gaussians, without a browser."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from core_rasterizer import Camera, Device, GaussianModel, Gaussians, load_ply, save_ply
from stereogs.verbs.view.edits import Edits, Stroke, clicked, in_ball, in_rectangle
from stereogs.verbs.view.subject import of_file


def mask(text: str) -> torch.Tensor:
    return torch.tensor([letter == "x" for letter in text])


def test_deleted_gaussians_are_not_selected_and_undo_takes_back_each_change() -> None:
    edits = Edits(4)
    edits.select(mask("xx.."), add=True)
    edits.select(mask(".xx."), add=True)
    edits.select(mask("x..."), add=False)
    assert edits.selected.equal(mask(".xx."))
    edits.delete()
    assert edits.deleted.equal(mask(".xx."))
    assert edits.selected.equal(mask("...."))
    edits.select(mask("xxx."), add=True)
    assert edits.selected.equal(mask("x..."))
    edits.invert(~edits.deleted)
    assert edits.selected.equal(mask("...x"))
    before = edits.revision
    edits.select(mask("...x"), add=True)  # changes nothing, so there is nothing to take back
    assert edits.revision == before
    assert edits.select(mask("x..."), add=True)
    assert edits.select(mask("...x"), add=False, joins=True)  # undone together
    for selected, deleted in (
        *(("...x", ".xx."), ("x...", ".xx.")),
        *(("....", ".xx."), (".xx.", "....")),
    ):
        edits.undo()
        assert edits.selected.equal(mask(selected))
        assert edits.deleted.equal(mask(deleted))
    for _ in range(5):
        edits.undo()
    assert not edits.selected.any()


def test_a_rectangle_selects_what_projects_into_it_and_is_in_front() -> None:
    pose = torch.eye(4, dtype=torch.float64)
    camera = Camera(
        pose, 100.0, 50.0, 40.0, 20.0, 80, 60
    )  # the centre of the image is not (cx, cy)
    means = torch.tensor([[0.0, 0, 1], [0.3, 0, 1], [0.0, 0.5, 1], [0.0, 0, -1], [0.0, 0, 9]])
    u, v, _ = camera.project(means)
    assert (u[1], v[2]) == pytest.approx((70, 45))
    left_top = in_rectangle(means, camera, (0.4, 0.3), (0.6, 0.4))
    assert left_top.equal(mask("x...x"))
    assert in_rectangle(means, camera, (0.4, 0.3), (0.9, 0.4)).equal(mask("xx..x"))
    assert in_rectangle(means, camera, (0.4, 0.3), (0.6, 0.8)).equal(mask("x.x.x"))


def test_a_click_finds_the_surface(device: Device) -> None:
    grid = torch.cartesian_prod(torch.linspace(-0.5, 0, 9), torch.linspace(-1, 1, 17))
    means = torch.cat([grid, torch.full((len(grid), 1), 3.0)], dim=1)
    sizes = torch.full((len(grid),), 0.08)
    gaussians = Gaussians.from_points(means, means * 0 + 0.5, sizes, sizes * 0 + 0.99, 0)
    camera = Camera.centered(torch.eye(4), 60.0, 64, 48)
    rendering = GaussianModel(gaussians, device).render(camera)
    found = clicked(camera, rendering, (0.45, 0.5))
    assert found is not None
    assert found.tolist() == pytest.approx([(0.45 * 64 // 1 + 0.5 - 32) / 20, 0.025, 3.0], abs=0.02)
    assert clicked(camera, rendering, (0.95, 0.5)) is None
    assert clicked(camera, rendering, (1.0, 1.0)) is None
    assert in_ball(means, found, 0.2).sum() < len(means) / 4
    assert in_ball(means, found, 9.0).all()


def test_a_brush_touches_what_is_seen_along_its_way(device: Device) -> None:
    """A wall at depth 3 in the left half; dots just behind it, far behind it, and beside it."""
    wall = torch.cartesian_prod(torch.linspace(-2, -0.1, 25), torch.linspace(-1.5, 1.5, 40))
    wall = torch.cat([wall, torch.full((len(wall), 1), 3.0)], dim=1)
    dots = torch.tensor([[-0.6, 0.0, 3.02], [-0.8, 0.0, 4.0], [0.6, 0.0, 3.0], [1.6, 0.0, 5.0]])
    means = torch.cat([dots, wall])
    sizes = torch.full((len(means),), 0.06)
    gaussians = Gaussians.from_points(means, means * 0 + 0.5, sizes, sizes * 0 + 0.99, 0)
    camera = Camera.centered(torch.eye(4), 60.0, 80, 60)
    rendering = GaussianModel(gaussians, device).render(camera)
    shown = torch.ones(len(means), dtype=torch.bool)

    def touched(*places: tuple[float, float], shown: torch.Tensor = shown) -> torch.Tensor:
        stroke = Stroke(means, shown, camera, rendering, places[0])
        return torch.stack([stroke.to(place, 0.05) for place in places[1:]]).any(dim=0)

    left, middle, right = (0.2, 0.5), (0.5, 0.5), (0.8, 0.5)
    across = touched(left, middle, right)
    assert across[:4].equal(mask("x.xx"))
    u, v, _ = camera.project(means)
    near = torch.hypot((16 - u).clamp(min=0), v - 30) / 60 <= 0.05  # the stroke begins at column 16
    assert across[4:].equal(near[4:])
    assert touched(left, left)[:4].equal(mask("...."))
    assert touched(middle, right)[:4].equal(mask("..xx")), "between two places too"
    assert touched(left, right, shown=torch.arange(len(means)) != 2)[:4].equal(mask("x..x"))


def test_saved_gaussians_keep_their_bits_and_no_file_is_replaced(
    device: Device, tmp_path: Path
) -> None:
    torch.manual_seed(0)
    means = torch.randn(9, 3) * 1e4 + 3e6
    sizes = torch.full((9,), 2.0)
    save_ply(Gaussians.from_points(means, means * 0 + 0.3, sizes, sizes / 3, 1), tmp_path / "a.ply")
    subject = of_file(tmp_path / "a.ply", device)
    assert subject.source is not None
    kept = torch.arange(9) % 3 > 0
    path = subject.source.save(kept)
    assert path == tmp_path / "a-edited.ply"
    assert subject.source.save(kept) == tmp_path / "a-edited-2.ply"
    before, after = vars(load_ply(tmp_path / "a.ply")), vars(load_ply(path))
    assert all(after[name].equal(values[kept]) for name, values in before.items())
