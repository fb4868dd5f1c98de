"""python -m tests.runtimes.race_scenes VARIANT PART [FILE:N]: small scenes through all kernels.

Run by `tests.runtimes.races` below a simulator that reports races. FILE:N removes the Nth barrier of the
kernel file FILE first, so that the simulator has something to find.
"""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from typing import Any

import torch

from core_rasterizer import (
    Adam,
    Camera,
    Device,
    Edit,
    GaussianModel,
    Gaussians,
    Relocation,
    apply_edit,
    open_device,
    photometric_loss,
)
from core_rasterizer.device import program
from core_rasterizer.layout import PARAMETER_GROUPS
from core_rasterizer.matching import (
    FeatureSweep,
    PatchMatch,
    Penalties,
    ZnccSweep,
    aggregate,
    census_costs,
    feature_costs,
    pick,
    right_costs,
    zncc_costs,
)
from core_rasterizer.raster import Renderer

COUNT = 400
"""In four chunks of more than one batch on a GPU."""
SIDE = 72
"""Pixels; 81 tiles of 8x8."""


def scene() -> Gaussians:
    """Gaussians of equal depths in one corner, so that tiles stay empty, and one over the whole image."""
    generator = torch.Generator().manual_seed(7)
    means = torch.rand(COUNT, 3, generator=generator) * 0.6 - 0.9
    means[:, 2] = 4 + (4 * means[:, 2]).round() / 8
    log_scales = -4 + torch.rand(COUNT, 3, generator=generator)
    means[COUNT // 2] = torch.tensor([0.0, 0.0, 4.0])
    log_scales[COUNT // 2] = 1.5
    means[3, 2] = -1  # behind the camera
    return Gaussians(
        means=means,
        log_scales=log_scales,
        quaternions=torch.randn(COUNT, 4, generator=generator),
        opacity_logits=torch.rand(COUNT, generator=generator) - 1,
        sh=0.2 * torch.randn(COUNT, 4, 3, generator=generator),
    )


def engine(device: Device) -> None:
    """Two iterations: plain, and with all options of a render; edits between them."""
    model = GaussianModel(scene(), device, compensate_dilation=True)
    overrides = {"TILE_WIDTH": 8, "TILE_HEIGHT": 8}
    model.renderer = Renderer(device, footprint=model.footprint, overrides=overrides)
    optimizer, rates = Adam(model), dict.fromkeys(PARAMETER_GROUPS, 1e-3)
    pose = torch.eye(4, dtype=torch.float64).requires_grad_()
    camera = Camera(pose, 70.0, 70.0, 36.0, 36.0, width=SIDE, height=SIDE)
    target = torch.full((SIDE, SIDE, 3), 0.5)
    plain = Camera(torch.eye(4), 70.0, 70.0, 36.0, 36.0, width=SIDE, height=SIDE)
    rendering = model.render(plain)
    coverage: Any = rendering.coverage
    tiles = coverage._tiles_covered.read(0, COUNT)
    assert int(tiles.max()) > 64, f"no Gaussian covers more than {int(tiles.max())} tiles"
    photometric_loss(rendering, target).backward()
    optimizer.step(rates, 1)
    clone, split, prune = torch.zeros(3, COUNT, dtype=torch.bool)
    clone[10:20], split[30:40], prune[50:60] = True, True, True
    move = Relocation(source=torch.tensor([70, 70]), target=torch.tensor([80, 81]))
    edit = Edit(clone=clone, split=split, prune=prune, relocate=move)
    apply_edit(model, optimizer, edit, torch.Generator().manual_seed(0))
    rendering = model.render(
        camera,
        sh_degree=0.5,
        opacity_scale=torch.full((model.count,), 0.9),
        smoothing=torch.full((model.count,), 0.01),
        collect_statistics=True,
        collect_absolute=True,
    )
    loss = photometric_loss(rendering, target) + 0.01 * rendering.depth.mean()
    (loss + 0.01 * model.parameter("scales").mean()).backward()
    optimizer.step(rates, 1)
    optimizer.check_parameters()


def matching(device: Device) -> None:
    """Both sweeps, rectified costs, aggregation and PatchMatch on three views."""
    generator = torch.Generator().manual_seed(3)
    cameras = []
    for position in (0.0, 0.3, -0.3):
        pose = torch.eye(4, dtype=torch.float64)
        pose[0, 3] = position
        cameras.append(Camera.centered(pose, 24, 20, 14))
    greys = [torch.rand(14, 20, generator=generator) for _ in cameras]
    vectors = torch.rand(len(cameras), 3, 14, 20, generator=generator)
    features = list(torch.nn.functional.normalize(vectors, dim=1))
    depths = torch.linspace(0.2, 0.5, 5, dtype=torch.float64)
    penalties = Penalties(10, 250)
    volumes = [
        ZnccSweep(device, greys, cameras, depths, radius=1).costs(0, [1, 2]),
        FeatureSweep(device, features, cameras, depths).costs(0, [1, 2]),
        zncc_costs(device, greys[0], greys[1], 5, 1),
        census_costs(device, greys[0], greys[1], 5),
        feature_costs(device, features[0], features[1], 5),
    ]
    volumes.append(right_costs(device, volumes[2]))
    for costs in volumes:
        pick(device, aggregate(device, costs, greys[0], penalties), 5)
    PatchMatch(device, greys, cameras, (2.0, 5.0), radius=1).maps([[1, 2], [0], [0, 1]])


def without_barrier(file: str, number: int) -> None:
    """Remove one barrier of a kernel file from all programs that are built later."""
    original = program._source

    def source(name: str | program.KernelText) -> str:
        text = original(name)
        if name != file:
            return text
        barriers = list(re.finditer(r"\bbarrier\([^)]*\);?", text))
        start, end = barriers[number].span()
        return text[:start] + (";" if text[end - 1] == ";" else "") + text[end:]

    program._source = source


def main() -> None:
    """Run one part with one variant of the kernels."""
    variant, part, *removed = sys.argv[1:]
    for each in removed:
        name, _, number = each.partition(":")
        without_barrier(name, int(number))
    device = open_device().as_variant("cpu" if variant == "cpu" else "gpu").as_discrete()
    # Parallel chunks for these few Gaussians too.
    device.profile = replace(device.profile, few=-1)
    if part == "engine":
        # oclgrind 21.10 computes NaN with the vectors of the CPU's kernels, so the projection has one lane.
        device.profile = replace(device.profile, lanes=1)
    {"engine": engine, "matching": matching}[part](device)
    device.finish()
    print(f"finished on {device}")


if __name__ == "__main__":
    main()
