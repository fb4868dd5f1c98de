"""Tiny TorchScript modules with the parameters of real networks."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn


class Mean(nn.Module):
    """Depth between the bounds by the mean brightness of the sources; confidence is the reference's red.

    The form of PatchmatchNet.
    """

    def forward(
        self,
        images: list[Tensor],
        intrinsics: Tensor,
        extrinsics: Tensor,
        depth_min: Tensor,
        depth_max: Tensor,
    ) -> tuple[Tensor, Tensor, dict[int, list[Tensor]]]:
        bright = torch.stack(images[1:]).mean(dim=0).mean(dim=1, keepdim=True)
        depth = depth_min + bright * (depth_max - depth_min)
        return depth, images[0][:, 0], {0: [depth]}


class Numbers(nn.Module):
    """A dictionary; the depth is one number of the cameras, chosen by the image's red in whole steps."""

    def forward(
        self, images: Tensor, K: Tensor, cam_T_world: Tensor, depth_range: Tensor
    ) -> dict[str, Tensor]:
        values = [K[0, 0, 0, 0], K[0, 0, 0, 2], K[0, 1, 1, 2], cam_T_world[0, 1, 0, 3]]
        values += [depth_range[0, 0], depth_range[0, 1]]
        row = torch.stack(values)
        plane = images[:, 0, 0]
        return {"depth": row[(plane[:, :1, :1] * 10).round().long()].expand_as(plane)}


class Random(nn.Module):
    """Random depths."""

    def forward(self, images: list[Tensor]) -> Tensor:
        return 1 + torch.rand_like(images[0][:, 0])


class Other(nn.Module):
    """A parameter that nobody knows."""

    def forward(self, images: list[Tensor], pose_encoding: Tensor) -> Tensor:
        return images[0]


class Strict(nn.Module):
    """Fails unless the height is a multiple of 64; then it answers the images."""

    def forward(self, images: Tensor) -> Tensor:
        if images.shape[3] % 64 != 0:
            raise RuntimeError("the height must be a multiple of 64")
        return images


def saved(path: Path, module: nn.Module) -> Path:
    """Write a module as TorchScript."""
    torch.jit.script(module).save(str(path))
    return path
