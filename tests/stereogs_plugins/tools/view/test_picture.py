from __future__ import annotations

import torch

from core_rasterizer import Device, GaussianModel, Gaussians
from stereogs_plugins.tools.view.picture import Box, Look, kept
from stereogs_plugins.tools.view.subject import Subject


def test_kinds_and_the_box_leave_out_together(device: Device) -> None:
    positions = torch.tensor([[0.0, 0, 1], [0, 0, 2], [0, 0, 3], [5, 0, 2]])
    ones = torch.full((4,), 0.1)
    gaussians = Gaussians.from_points(positions, torch.full((4, 3), 0.5), ones, ones, 0)
    kinds = {"guessed": torch.tensor([False, True, False, False])}
    subject = Subject("x", GaussianModel(gaussians, device), kinds=kinds)
    assert kept(subject, Look()) is None
    box = Box((-1.0, -1.0, 0.0), (1.0, 1.0, 2.5))
    assert kept(subject, Look(box=box)).tolist() == [True, True, False, False]  # type: ignore[union-attr]
    both = kept(subject, Look(hidden=("guessed",), box=box))
    assert both is not None
    assert both.tolist() == [True, False, False, False]
