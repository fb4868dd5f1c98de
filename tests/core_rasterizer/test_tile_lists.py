"""The lists of Gaussians by tile: complete, ordered, independent of the parallelization."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from core_rasterizer import Camera, Device, GaussianModel
from core_rasterizer.raster import RenderRequest
from core_rasterizer.raster.budget import RECORD
from tests.core_rasterizer.test_model import parameters, view

CUT = 1 / 255


class Lists(NamedTuple):
    """Arrays of a render, on the host."""

    records: NDArray[np.float32]
    """`[N, 16]`, see `scene.cl`."""
    pairs: NDArray[np.int32]
    """`[P, 2]`: Gaussian, slot."""
    starts: NDArray[np.int32]
    """`[tiles + 1]`: where each tile's pairs begin."""
    tile: tuple[int, int]
    tiles_across: int


def lists_of(
    device: Device, model: GaussianModel | None = None, camera: Camera | None = None
) -> Lists:
    model, camera = model or GaussianModel(parameters(300), device), camera or view()
    renderer = model.renderer
    frame = renderer.forward(model.block, RenderRequest(camera, (0.0, 0.0, 0.0), 3))[1].frame
    tiles = frame.tiles[0] * frame.tiles[1]
    arrays = {
        name: frame.arrays[name].read().numpy() for name in ("records", "pairs", "tile_starts")
    }
    return Lists(
        arrays["records"].reshape(-1, RECORD).copy(),
        arrays["pairs"][: 2 * frame.pairs].reshape(-1, 2).copy(),
        arrays["tile_starts"][: tiles + 1].copy(),
        renderer.programs.tile,
        frame.tiles[0],
    )


def touches(record: NDArray[np.float32], x0: int, y0: int, width: int, height: int) -> bool:
    """Whether alpha reaches 1/255 at a pixel of a tile well inside the cut-off."""
    x = x0 + np.arange(width) + 0.5 - record[0]
    y = (y0 + np.arange(height) + 0.5 - record[1])[:, None]
    exponent = record[2] * x * x + record[3] * x * y + record[4] * y * y
    return bool((record[5] * np.exp2(np.minimum(exponent, 0)) > 1.001 * CUT).any())


def test_each_list_is_complete_and_nearest_first(device: Device) -> None:
    lists = lists_of(device)
    width, height = lists.tile
    camera = view()
    shown = set(lists.pairs[:, 0].tolist())
    assert len(shown) > 100
    for tile in range(len(lists.starts) - 1):
        row, column = divmod(tile, lists.tiles_across)
        x0, y0 = column * width, row * height
        size = min(width, camera.width - x0), min(height, camera.height - y0)
        listed = lists.pairs[lists.starts[tile] : lists.starts[tile + 1], 0].tolist()
        assert len(set(listed)) == len(listed)
        depths = [(float(lists.records[g, 9]), g) for g in listed]
        assert depths == sorted(depths)
        for g in shown - set(listed):
            assert not touches(lists.records[g], x0, y0, *size), (tile, g)


def test_slots_of_a_gaussian_are_neighbours_and_no_two_pairs_share_one(device: Device) -> None:
    pairs = lists_of(device).pairs
    assert sorted(pairs[:, 1].tolist()) == list(range(len(pairs)))
    for g in np.unique(pairs[:, 0]):
        slots = np.sort(pairs[pairs[:, 0] == g, 1])
        assert (np.diff(slots) == 1).all()


def test_one_launch_for_few_gives_the_lists_of_many(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also alternating in the same scratch memory."""
    if device.variant == "gpu":
        pytest.skip("a GPU always shares the work")
    expected = lists_of(device)
    model = GaussianModel(parameters(300), device)
    for few in (0, 300, 0, 300):
        monkeypatch.setattr(model.renderer._lists, "_few", few)
        lists = lists_of(device, model)
        assert np.array_equal(lists.pairs, expected.pairs)
        assert np.array_equal(lists.starts, expected.starts)


@pytest.mark.parametrize("chunks", [1, 7, 500])
def test_the_number_of_chunks_changes_nothing(
    device: Device, chunks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = lists_of(device)
    monkeypatch.setattr("core_rasterizer.raster.tile_lists.FEW", 0)
    for module in ("tile_lists", "renderer"):
        monkeypatch.setattr(f"core_rasterizer.raster.{module}.chunks_of", lambda device: chunks)
    lists = lists_of(device)
    assert np.array_equal(lists.pairs, expected.pairs)
    assert np.array_equal(lists.starts, expected.starts)


def test_many_tiles_and_equal_depths_are_shared_out_as_one_would_have_them(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With one chunk, with few, and with more chunks than Gaussians."""
    gaussians = parameters(200)
    gaussians.means[:, 2] = gaussians.means[:, 2].round().clamp(min=1)
    gaussians.log_scales[::20] = 0.0
    camera = Camera(torch.eye(4), 200.0, 200.0, 160.0, 120.0, 320, 240)
    monkeypatch.setattr("core_rasterizer.raster.tile_lists.FEW", 0)
    lists = []
    for chunks in (1, 256):
        for module in ("tile_lists", "renderer"):
            monkeypatch.setattr(
                f"core_rasterizer.raster.{module}.chunks_of", lambda device, n=chunks: n
            )
        lists.append(lists_of(device, GaussianModel(gaussians, device), camera))
    together, alone = lists
    assert np.array_equal(together.pairs, alone.pairs)
    assert np.array_equal(together.starts, alone.starts)
    boxes = together.records[:, 10:14]
    spans = np.maximum(boxes[:, 1] - boxes[:, 0], 0) * np.maximum(boxes[:, 3] - boxes[:, 2], 0)
    if device.variant == "gpu":
        assert (spans > 64 * 16 * 16).any()
