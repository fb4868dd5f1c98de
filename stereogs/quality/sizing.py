"""The working size of photographs, from the time and the memory that there are.

Photographs are read at the size that their loader is set to. If first points and scores would take more than
half of the time left, or the run more than half of the free memory, they are read again at a smaller size.
"""

from __future__ import annotations

from math import sqrt
from statistics import median
from time import process_time
from typing import TYPE_CHECKING, NamedTuple

from registry.system.memory import available_bytes

if TYPE_CHECKING:
    from core_rasterizer import Device
    from registry import Scene

SMALLEST = 256
"""Longer side in pixels that time and memory never go below."""
SHARE = 0.5
"""Largest share of the time left for first points and scores, and of the free memory for the run."""
MIN_CHANGE = 0.9
"""A size is kept if the new one is larger than this multiple: reading again takes time too."""
SWEEPS, SWEEPS_AROUND = 530.0, 1700.0
"""CPU time of first points and scores per megapixel of training views, in units of `sweep_seconds`; the
second if two cameras look in directions more than 90 degrees apart, which needs PatchMatch."""
BYTES_PER_PIXEL = 1000
"""Memory that a run adds for each pixel of the largest view: the cost volume of 192 planes, four bytes each,
and its depth maps."""
BYTES_PER_VIEW_PIXEL = 300
"""Memory for each pixel of all views: images, depth maps, and Gaussians with gradients and moments."""
_WIDTH, _HEIGHT, _PLANES = 256, 192, 64
_REPEATED = 3


class Size(NamedTuple):
    """A longer side in pixels and the reason for it, "time" or "memory"."""

    pixels: int
    reason: str


def smaller_size(scene: Scene, cpu_seconds: float | None, device: Device) -> Size | None:
    """Return the size at which to read the photographs again; None keeps the present one.

    Args:
        cpu_seconds: CPU seconds that the process can expect in the time left; None: no limit.
    """
    sizes = [(view.camera.width, view.camera.height) for view in (*scene.train, *scene.test)]
    longer = max(max(size) for size in sizes)
    pixels = [width * height for width, height in sizes]
    memory = BYTES_PER_PIXEL * max(pixels) + BYTES_PER_VIEW_PIXEL * sum(pixels)
    found = [(SHARE * available_bytes() / memory, "memory")]
    if cpu_seconds is not None:
        sweeps = SWEEPS_AROUND if _looks_around(scene) else SWEEPS
        needed = sweeps * sweep_seconds(device) * sum(pixels[: len(scene.train)]) / 1e6
        found.append((max(0.0, SHARE * cpu_seconds / needed), "time"))
    share, reason = min(found)
    size = max(SMALLEST, int(longer * sqrt(min(1.0, share))))
    return Size(size, reason) if size < MIN_CHANGE * longer else None


def _looks_around(scene: Scene) -> bool:
    """Whether two training cameras look in directions more than 90 degrees apart."""
    import torch

    directions = torch.stack([view.camera.world_to_camera[2, :3] for view in scene.train])
    return bool((directions @ directions.T).min() < 0)


def sweep_seconds(device: Device) -> float:
    """Return the CPU seconds of a small dense matching on this machine."""
    import torch

    from core_rasterizer.matching import Penalties, aggregate, pick, zncc_costs

    image = torch.rand(_HEIGHT, _WIDTH, generator=torch.Generator().manual_seed(0))

    def sweep() -> float:
        begin = process_time()
        costs = zncc_costs(device, image, image, _PLANES, 2)
        pick(device, aggregate(device, costs, image, Penalties(10, 4000)), _PLANES)
        return process_time() - begin

    sweep()  # not counted: it compiles kernels
    return median(sweep() for _ in range(_REPEATED))
