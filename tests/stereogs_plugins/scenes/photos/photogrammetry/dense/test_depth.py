"""What two pictures confirm, without the parts that masks exclude."""

from __future__ import annotations

import torch

from core_rasterizer import Camera, open_device
from stereogs_plugins.scenes.photos.photogrammetry.dense.depth import (
    PinholePhoto,
    confirmed,
    depth_of,
)


def test_a_picture_of_other_brightness_gives_and_confirms_the_depth() -> None:
    """A wall at depth 4, seen from two places that are eight pixels apart."""
    wall = torch.rand(32, 72, generator=torch.Generator().manual_seed(0))
    poses = [torch.eye(4), torch.eye(4)]
    poses[1][0, 3] = -0.8
    pictures = 0.5 * wall[:, :64], wall[:, 8:]
    here, there = (
        PinholePhoto(picture, Camera.centered(pose, 40.0, 64, 32), (2.0, 8.0), None)
        for picture, pose in zip(pictures, poses, strict=True)
    )
    depth = depth_of(open_device(), here, there)
    torch.testing.assert_close(depth[4:28, 16:56], depth.new_full((24, 40), 4), rtol=0.02, atol=0)
    flat = torch.full_like(depth, 4)
    assert confirmed(here, there, flat, flat).pixels[:, 12:60].all()


def test_masks_exclude_pixels_of_both_pictures() -> None:
    """A wall at depth 4, seen from two places that are eight pixels apart."""
    wall = torch.rand(32, 72, generator=torch.Generator().manual_seed(0))
    poses = [torch.eye(4), torch.eye(4)]
    poses[1][0, 3] = -0.8
    one, other = (Camera.centered(pose, 40.0, 64, 32) for pose in poses)
    pictures = wall[:, :64], wall[:, 8:]
    depth = torch.full((32, 64), 4.0, dtype=torch.float64)
    masks = torch.ones(2, 32, 64, dtype=torch.bool)
    masks[0, :, :20], masks[1, :, 40:] = False, False

    def found(first: torch.Tensor | None, second: torch.Tensor | None) -> torch.Tensor:
        here = PinholePhoto(pictures[0], one, (2.0, 8.0), first)
        there = PinholePhoto(pictures[1], other, (2.0, 8.0), second)
        return confirmed(here, there, depth, depth).pixels

    assert found(None, None)[:, 12:60].all()
    masked = found(masks[0], masks[1])
    assert masked[:, 20:48].all()
    assert not masked[:, :20].any()
    assert not masked[:, 48:].any()  # where the second picture is masked, eight pixels further left
