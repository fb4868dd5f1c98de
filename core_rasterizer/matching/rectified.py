"""Cost volumes of rectified pairs: plane d of a volume is the disparity of d pixels.

The left image's pixel (u, v) is compared with the right image's (u - d, v). Costs are 127.5 * (1 -
correlation), rounded, or 255 times the share of differing signs. Where u - d is outside the image they are
`UNSEEN_CORRELATION` or `UNSEEN_CENSUS`: more than a good match and less than a wrong one, which on real
pairs is more accurate than 255. Volumes are uint8 `[H, W, D]` as in `semi_global`, with `planes` rounded up
to D.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..device import Device, DeviceArray
from .limits import MAX_RADIUS
from .semi_global import empty_volume

UNSEEN_CORRELATION = 128
"""Correlation 0, like windows without texture."""
UNSEEN_CENSUS = 96
"""Measured. Flat windows match perfectly in census, so they prefer a match despite the low value."""
_NOISE = 0.002
"""Standard deviation of grey values in [0, 1] that counts as no texture."""
_CENSUS_COLUMNS, _CENSUS_ROWS = 9, 7


def zncc_costs(
    device: Device, left: Tensor, right: Tensor, planes: int, radius: int
) -> DeviceArray:
    """Zero-mean normalized cross-correlation of square windows.

    Windows without texture have correlation 0, cost 128. Images are padded with their edge values.

    Args:
        left, right: `[H, W]` grey in [0, 1].
        planes: disparities 0 .. planes - 1.
        radius: of the window, pixels, 1 <= radius <= `MAX_RADIUS`; its side is 2 radius + 1.

    Raises:
        ValueError: the images differ in size, or `planes` or `radius` is out of range.
        MemoryBudgetError: see `empty_volume`; also for the other costs.
    """
    _check(left, right, planes)
    if not 1 <= radius <= MAX_RADIUS:
        raise ValueError(f"the radius is {radius}, not in 1 .. {MAX_RADIUS}")
    height, width = left.shape
    costs = empty_volume(device, height, width, planes)
    depth = costs.shape[2]
    # Sums of squares over a window stay below 2^24, exact in float32; see the kernel.
    levels = 2**12 // (2 * radius + 1)
    maps: dict[str, Tensor] = {}
    for name, image, mirrored in (("left", left, False), ("right", right, True)):
        grey = _whole_levels(image.flip(1) if mirrored else image, levels)
        padded = pad(grey[None], (radius,) * 4, mode="replicate")[0]
        total, square = _window_sums(padded, radius), _window_sums(padded * padded, radius)
        count = (2 * radius + 1) ** 2
        spread = square - total * total / count + count * (2 * levels * _NOISE) ** 2
        beyond = (0, depth if mirrored else 0)
        maps[name] = pad(padded, beyond)
        maps["right_mean" if mirrored else "left_sum"] = pad(
            total / count if mirrored else total, beyond
        )
        maps[f"{name}_scale"] = pad(spread.rsqrt(), beyond)
    arrays = {name: _on_device(device, values, torch.float32) for name, values in maps.items()}
    program = device.program("matching/rectified", dtype=torch.float32, RADIUS=radius)
    rows = device.profile.window_rows
    size = (depth // device.lanes, width, -(-height // rows))
    program.run(
        "correlate_windows",
        size,
        None,
        **arrays,
        costs=costs,
        height=height,
        width=width,
        planes=planes,
        depth=depth,
        unseen=UNSEEN_CORRELATION,
        rows=rows,
    )
    return costs


def census_costs(device: Device, left: Tensor, right: Tensor, planes: int) -> DeviceArray:
    """Census transform (Zabih and Woodfill 1994) of windows 9 wide and 7 high.

    Args:
        left, right: `[H, W]` grey.
        planes: disparities 0 .. planes - 1.

    Raises:
        ValueError: the images differ in size, or `planes` < 1.
    """
    _check(left, right, planes)
    height, width = left.shape
    costs = empty_volume(device, height, width, planes)
    depth = costs.shape[2]
    signs = [_census(image) for image in (left, right)]
    program = device.program("matching/rectified", dtype=torch.float32, RADIUS=1)
    bits = _CENSUS_COLUMNS * _CENSUS_ROWS - 1
    program.run(
        "compare_signs",
        (1 if device.kind == "cpu" else depth // device.lanes, width, height),
        None,
        left=_on_device(device, signs[0], torch.int64),
        right=_on_device(device, pad(signs[1].flip(1), (0, depth)), torch.int64),
        costs=costs,
        width=width,
        planes=planes,
        depth=depth,
        unseen=UNSEEN_CENSUS,
        bits=bits,
    )
    return costs


def feature_costs(device: Device, left: Tensor, right: Tensor, planes: int) -> DeviceArray:
    """Dot product of feature vectors, for example of a neural network.

    Args:
        left, right: `[C, H, W]` float32, of length 1 over C (or 0, cost 128).
        planes: disparities 0 .. planes - 1.

    Raises:
        ValueError: the maps differ in size, or `planes` < 1.
    """
    _check(left, right, planes, dimensions=3)
    channels, height, width = left.shape
    costs = empty_volume(device, height, width, planes)
    depth = costs.shape[2]
    rows = [left.permute(1, 0, 2), pad(right.flip(2), (0, depth)).permute(1, 0, 2)]
    program = device.program("matching/rectified", dtype=torch.float32, RADIUS=1)
    program.run(
        "correlate_features",
        (depth // device.lanes, width, height),
        None,
        left=_on_device(device, rows[0], torch.float32),
        right=_on_device(device, rows[1], torch.float32),
        costs=costs,
        channels=channels,
        width=width,
        planes=planes,
        depth=depth,
        unseen=UNSEEN_CORRELATION,
    )
    return costs


def right_costs(device: Device, costs: DeviceArray) -> DeviceArray:
    """The right image's volume: the same matches, by pixel of the right image.

    Args:
        costs: the left image's volume.
    """
    height, width, depth = costs.shape
    result = DeviceArray(device, costs.shape, torch.uint8)
    program = device.program("matching/rectified", dtype=torch.float32, RADIUS=1)
    volumes = {"left_costs": costs, "right_costs": result}
    size = (1 if device.kind == "cpu" else depth, width, height)
    program.run("costs_of_right", size, None, **volumes, width=width, depth=depth)
    return result


def _check(left: Tensor, right: Tensor, planes: int, dimensions: int = 2) -> None:
    if left.ndim != dimensions or left.shape != right.shape or not left.numel():
        raise ValueError(f"a pair has the shapes {tuple(left.shape)} and {tuple(right.shape)}")
    if planes < 1:
        raise ValueError(f"planes is {planes}; it must be at least 1")


def _on_device(device: Device, values: Tensor, dtype: torch.dtype) -> DeviceArray:
    array = DeviceArray(device, tuple(values.shape), dtype)
    array.write(values)
    return array


def _whole_levels(grey: Tensor, levels: int) -> Tensor:
    """`[H, W]` float64 whole numbers from -levels to levels."""
    return ((grey.double().clamp(0, 1) * 2 - 1) * levels).round()


def _window_sums(padded: Tensor, radius: int) -> Tensor:
    """Sums over square windows; exact, because values are whole numbers."""
    side = 2 * radius + 1
    sums = pad(padded, (1, 0, 1, 0)).cumsum(0).cumsum(1)
    return sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]


def _census(grey: Tensor) -> Tensor:
    """`[H, W]` int64: one bit per neighbour, set if it is darker than the centre."""
    across, down = _CENSUS_COLUMNS // 2, _CENSUS_ROWS // 2
    height, width = grey.shape
    padded = pad(grey[None], (across, across, down, down), mode="replicate")[0]
    signs = torch.zeros(height, width, dtype=torch.int64)
    for row in range(_CENSUS_ROWS):
        for column in range(_CENSUS_COLUMNS):
            if (row, column) != (down, across):
                neighbour = padded[row : row + height, column : column + width]
                signs = (signs << 1) | (neighbour < grey)
    return signs
