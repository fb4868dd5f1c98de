"""The lists of Gaussians by tile: complete, ordered, independent of the parallelization."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from core_rasterizer import (
    Adam,
    Camera,
    Device,
    Edit,
    GaussianModel,
    Gaussians,
    apply_edit,
    list_devices,
    photometric_loss,
)
from core_rasterizer.device import DeviceProfile, Launch, Program
from core_rasterizer.layout import COUNTERS, GAUSSIAN
from core_rasterizer.raster import Renderer, RenderRequest, gpu_tile_lists
from tests.core_rasterizer.scenes import parameters, random_camera, rates, view

CUT = 1 / 255


class Lists(NamedTuple):
    """Arrays of a render, on the host."""

    records: NDArray[np.float32]
    """`[N, 16]`, see `layout.GAUSSIAN`."""
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
        arrays["records"].reshape(-1, GAUSSIAN.size).copy(),
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
        monkeypatch.setattr(model.renderer._lists, "_profile", replace(device.profile, few=few))
        lists = lists_of(device, model)
        assert np.array_equal(lists.pairs, expected.pairs)
        assert np.array_equal(lists.starts, expected.starts)


@pytest.mark.parametrize("chunks", [1, 7, 500])
def test_the_number_of_chunks_changes_nothing(
    device: Device, chunks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = lists_of(device)
    lists = lists_of(shared_among(chunks, device, monkeypatch))
    assert np.array_equal(lists.pairs, expected.pairs)
    assert np.array_equal(lists.starts, expected.starts)


def shared_among(chunks: int, device: Device, monkeypatch: pytest.MonkeyPatch) -> Device:
    monkeypatch.setattr(DeviceProfile, "list_chunks", lambda profile, elements: chunks)
    other = device.as_variant(device.variant)
    other.profile = replace(device.profile, few=-1, chunks=chunks)
    return other


def many_equal_depths() -> tuple[Gaussians, Camera]:
    """With boxes of more than 64 tiles of 16x16 pixels."""
    gaussians = parameters(200)
    gaussians.means[:, 2] = gaussians.means[:, 2].round().clamp(min=1)
    gaussians.log_scales[::20] = 0.0
    return gaussians, Camera(torch.eye(4), 200.0, 200.0, 160.0, 120.0, 320, 240)


def test_many_tiles_and_equal_depths_are_shared_out_as_one_would_have_them(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With one chunk, and with more chunks than Gaussians."""
    gaussians, camera = many_equal_depths()
    lists = []
    for chunks in (1, 256):
        engine = shared_among(chunks, device, monkeypatch)
        lists.append(lists_of(engine, GaussianModel(gaussians, engine), camera))
    together, alone = lists
    assert np.array_equal(together.pairs, alone.pairs)
    assert np.array_equal(together.starts, alone.starts)
    boxes = together.records[:, 12:16]
    spans = np.maximum(boxes[:, 1] - boxes[:, 0], 0) * np.maximum(boxes[:, 3] - boxes[:, 2], 0)
    if device.variant == "gpu":
        assert (spans > 64 * 16 * 16).any()


def one_over_all_tiles() -> tuple[Gaussians, Camera]:
    """A Gaussian behind 3,000 others that reaches each of the 8,160 tiles of 1920x1080 pixels."""
    gaussians = parameters(3001)
    gaussians.log_scales[:-1] -= 2
    gaussians.means[-1] = torch.tensor([0.0, 0.0, 7.0])
    gaussians.log_scales[-1], gaussians.opacity_logits[-1] = 4.0, 1.0
    return gaussians, Camera(torch.eye(4), 1500.0, 1500.0, 960.0, 540.0, 1920, 1080)


def needles() -> tuple[Gaussians, Camera]:
    """Long diagonals: few of the tiles in their boxes are reached."""
    gaussians = parameters(500)
    gaussians.log_scales[:] = torch.tensor([1.5, -6.0, -6.0])
    return gaussians, Camera(torch.eye(4), 300.0, 300.0, 320.0, 240.0, 640, 480)


def trained() -> tuple[Gaussians, Camera]:
    """Fitted to two noisy images, with splits and clones; some Gaussians have grown large."""
    generator = torch.Generator().manual_seed(0)
    cameras = [random_camera(generator, 320, 240) for _ in range(2)]
    targets = [torch.rand(15, 20, 3, generator=generator) for _ in cameras]
    targets = [
        torch.nn.functional.interpolate(image.permute(2, 0, 1)[None], (240, 320))[0]
        .permute(1, 2, 0)
        .contiguous()
        for image in targets
    ]
    model = GaussianModel(parameters(2000), list_devices()[0].as_variant("cpu"))
    optimizer = Adam(model)
    for step in range(60):
        model.zero_gradients()
        rendering = model.render(cameras[step % 2], collect_statistics=True)
        photometric_loss(rendering, targets[step % 2]).backward()
        optimizer.step(rates(2e-2), active_sh_degree=3)
        if step % 20 == 19:
            busy = model.statistics.screen_gradient() > model.statistics.screen_gradient().median()
            large = model.scales().amax(dim=1) > 0.2
            edit = Edit(busy & ~large, busy & large, model.opacities() < 0.05)
            apply_edit(model, optimizer, edit, generator)
    return model.gaussians(), cameras[0]


def tiles_of_16(engine: Device, scene: tuple[Gaussians, Camera]) -> tuple[Any, ...]:
    """Lists and slots of a scene in tiles of 16x16 pixels, by either variant; candidates; steps."""
    gaussians, camera = scene
    model = GaussianModel(gaussians, engine)
    renderer = Renderer(engine, overrides={"TILE_WIDTH": 16, "TILE_HEIGHT": 16})
    request = RenderRequest(camera, (0.0, 0.0, 0.0), 0)
    frame = renderer.forward(model.block, request)[1].frame
    read = {
        name: frame.arrays[name].read().numpy().copy()
        for name in ("pairs", "tile_starts", "slot_start", "slot_count", "counters")
    }
    counts = read["slot_count"][: len(gaussians)]
    return (
        read["pairs"][: 2 * frame.pairs],
        read["tile_starts"][: frame.tiles[0] * frame.tiles[1] + 1],
        counts,
        np.where(counts > 0, read["slot_start"][: len(gaussians)], 0),
        read["counters"][:2],
        candidates_of(renderer) // engine.profile.list_chunks(len(read["pairs"]) // 2),
        int(read["counters"][COUNTERS.first["last"]]),
    )


def candidates_of(renderer: Renderer) -> int:
    """An upper bound: the tiles of all boxes of the last render."""
    sizes = renderer._lists.covers.read().numpy().reshape(-1, 4)[:, 1]
    return int(((sizes & 0xFFFF) * (sizes >> 16)).sum())


@pytest.mark.parametrize(
    "make",
    [many_equal_depths, one_over_all_tiles, needles, trained],
    ids=lambda make: make.__name__,
)
def test_a_gpu_makes_the_lists_of_a_cpu_and_no_work_item_takes_long(
    device: Device,
    make: Callable[[], tuple[Gaussians, Camera]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The same bits. Steps are loop rounds that the kernels count; the largest Gaussian adds none.

    A work-item takes eight elements of a chunk. For each, sorting compares it with the 256 of the
    round, and making pairs looks for the Gaussian that a candidate belongs to and adds up 48 numbers.
    Candidates are the tiles of large boxes, so needles have many more of them than pairs, but every
    work-item takes the same share.
    """
    if device.variant == "cpu":
        pytest.skip("compares the other variant with this one")
    monkeypatch.setattr(gpu_tile_lists, "MACROS", {"COUNT_STEPS": 1})
    scene = make()
    *ours, share, steps = tiles_of_16(device.as_variant("gpu"), scene)
    *theirs, _, _ = tiles_of_16(device.as_variant("cpu"), scene)
    for one, other in zip(ours, theirs, strict=True):
        assert np.array_equal(one, other)
    sorting = 8 * (256 + 1) + 3 * 2048 // 256
    pairs = (share // 256 + 1) * (2 + 48 + 6 + math.log2(len(scene[0])))
    assert 300 < steps <= max(sorting, pairs), steps
    assert steps <= sorting or make is needles


def test_lists_are_prepared_once_while_nothing_changes(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a change of the image's size or of the Gaussians they are prepared again."""
    generator = torch.Generator().manual_seed(0)
    camera = random_camera(generator, 64, 48)
    smaller = camera.resized(40, 30)
    model, prepared = GaussianModel(parameters(40), device), list[str]()
    prepare = Program.prepare

    def counted(program: Program, kernel: str, *sizes: Any, **arguments: Any) -> Launch:
        prepared.append(kernel)
        return prepare(program, kernel, *sizes, **arguments)

    monkeypatch.setattr(Program, "prepare", counted)

    def lists_prepared(at: Camera) -> bool:
        prepared.clear()
        image, again = model.render(at).rgb.clone(), bool(prepared)
        assert torch.equal(image, GaussianModel(model.gaussians(), device).render(at).rgb)
        return again

    first = [lists_prepared(at) for at in (camera, camera, smaller, smaller)]
    assert first == [True, False, True, False]
    edit = Edit(prune=torch.arange(40) == 3)
    apply_edit(model, Adam(model), edit, generator)
    assert [lists_prepared(smaller) for _ in range(2)] == [True, False]
