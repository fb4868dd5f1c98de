"""Semi-global aggregation of a cost volume (Hirschmüller, PAMI 2008) and selection of the best plane.

A cost volume is a uint8 `DeviceArray [H, W, D]`: the cost of D planes (disparities, depths) at each
pixel, 0 = best, 255 = worst or unknown. D is a multiple of `PLANE_MULTIPLE`; padding planes cost 255.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import torch
from torch import Tensor

from ..device import Device, DeviceArray, Program
from ..errors import MemoryBudgetError
from .limits import MAX_PENALTY

CostVolume: TypeAlias = DeviceArray
"""uint8 `[H, W, D]`, as above."""
PLANE_MULTIPLE = 16
"""Vector width in planes."""
_BYTES_A_CELL = 4
"""One byte of costs, two of sums, and one for the costs of a second image."""


@dataclass(frozen=True)
class Penalties:
    """Penalties of a path for changing the plane between two pixels.

    Args:
        small: P1, for a change of one plane.
        large: P2, for larger changes where the image is flat. Where the grey value changes by g of
            255 levels, P2 is large / max(1, g), but at least P1.

    Raises:
        ValueError: not 0 <= small <= large <= `MAX_PENALTY`.
    """

    small: int
    large: int

    def __post_init__(self) -> None:
        if not 0 <= self.small <= self.large <= MAX_PENALTY:
            raise ValueError(f"penalties must be 0 <= small <= large <= {MAX_PENALTY}, got {self}")

    def by_grey_step(self) -> Tensor:
        """`[256]` int64: P2 for each difference of grey levels."""
        steps = torch.arange(256).clamp(min=1)
        return torch.clamp(self.large // steps, min=self.small)


def padded_planes(planes: int) -> int:
    """Number of planes of a volume including padding."""
    return -(-planes // PLANE_MULTIPLE) * PLANE_MULTIPLE


def empty_volume(device: Device, height: int, width: int, planes: int) -> DeviceArray:
    """Allocate the costs of `planes` planes, uint8 `[H, W, D]`.

    Raises:
        MemoryBudgetError: processing it needs more than half of the device's memory.
    """
    depth = padded_planes(planes)
    needed, limit = height * width * depth * _BYTES_A_CELL, device.memory_bytes // 2
    if needed > limit:
        raise MemoryBudgetError(
            f"{planes} planes of {width}x{height} pixels need {needed / 2**20:,.0f} MB; "
            f"the budget is {limit / 2**20:,.0f} MB",
            where="matching costs",
            fix="use fewer planes or smaller images",
        )
    return DeviceArray(device, (height, width, depth), torch.uint8)


def aggregate(
    device: Device, costs: DeviceArray, image_gray: Tensor, penalties: Penalties
) -> DeviceArray:
    """Sum the costs of the cheapest paths that reach each pixel from eight directions.

    Args:
        costs: uint8 `[H, W, D]`, see above.
        image_gray: `[H, W]` in [0, 1]; jumps are cheaper at its edges.

    Returns:
        uint16 `[H, W, D]`, at most 8 (255 + penalties.large).

    Raises:
        ValueError: D is not a multiple of `PLANE_MULTIPLE`, or the image has another size.
    """
    height, width, planes = costs.shape
    if planes % PLANE_MULTIPLE or tuple(image_gray.shape) != (height, width):
        raise ValueError(f"costs {costs.shape} do not match the image {tuple(image_gray.shape)}")
    sums = DeviceArray(device, costs.shape, torch.uint16)
    if not height * width * planes:
        return sums
    grey = DeviceArray(device, (height, width), torch.uint8)
    grey.write((image_gray.clamp(0, 1) * 255).round())
    jumps = DeviceArray(device, (256,), torch.uint16)
    jumps.write(penalties.by_grey_step())
    program, band = _program(device, planes), device.profile.path_lines
    for path in _directions(height, width):
        items = -(-path.lines // band)
        program.run(
            "aggregate_direction",
            (items,),
            None,
            costs=costs,
            grey=grey,
            jump_penalties=jumps,
            sums=sums,
            width=width,
            small_penalty=penalties.small,
            **path._asdict(),
        )
    return sums


def pick(device: Device, aggregated: DeviceArray, planes: int) -> tuple[Tensor, Tensor]:
    """The plane of lowest aggregated cost at each pixel.

    Args:
        aggregated: uint16 `[H, W, D]` from `aggregate`.
        planes: number of planes without padding, 1 <= planes <= D.

    Returns:
        index: `[H, W]` float32; plane and fraction: the intersection of two lines of opposite slopes
            through the lowest cost and its two neighbours (Shimizu and Okutomi, 2005), on real pairs
            more accurate than a parabola. The first and the last plane have no fraction.
        confidence: `[H, W]` float32 in [0, 1]: 1 - lowest / rival, where the rival is the lowest cost
            more than one plane away; 0 if there is none.

    Raises:
        ValueError: `planes` is out of range.
    """
    height, width, padded = aggregated.shape
    if not 1 <= planes <= padded:
        raise ValueError(f"planes is {planes}; it must lie in 1 .. {padded}")
    index = DeviceArray(device, (height, width))
    confidence = DeviceArray(device, (height, width))
    if height * width:
        program = _program(device, padded)
        size = (height * width,)
        results = {"index": index, "confidence": confidence}
        program.run("pick_plane", size, None, sums=aggregated, planes=planes, **results)
    return index.read().clone(), confidence.read().clone()


def _program(device: Device, planes: int) -> Program:
    band = device.profile.path_lines
    return device.program("matching/semi_global", dtype=torch.float32, PLANES=planes, BAND=band)


class _Direction(NamedTuple):
    """Arguments of the kernel `aggregate_direction`."""

    lines: int
    steps: int
    origin: int
    across: int
    along: int
    shift: int = 0
    slope: int = 0


def _directions(height: int, width: int) -> list[_Direction]:
    """The eight directions."""
    last_row = (height - 1) * width
    paths = [
        _Direction(height, width, 0, width, 1),
        _Direction(height, width, width - 1, width, -1),
        _Direction(width, height, 0, 1, width),
        _Direction(width, height, last_row, 1, -width),
    ]
    lines = width + height - 1
    for slope in (1, -1):
        # Lines that move right start left of the image, and vice versa.
        shift = -(height - 1) if slope > 0 else 0
        paths.append(_Direction(lines, height, shift, 1, width + slope, shift, slope))
        paths.append(_Direction(lines, height, last_row + shift, 1, -width + slope, shift, slope))
    return paths
