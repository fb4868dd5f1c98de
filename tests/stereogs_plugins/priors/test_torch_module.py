"""Multi-view networks in TorchScript files: small modules, and PatchmatchNet."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import nn

from core_rasterizer import Camera
from registry import PluginError, View
from registry.priors import DepthMap
from stereogs_plugins.priors.torch_module import TorchModule, stereogs_register_priors
from stereogs_plugins.scenes.dtu import DTUScene
from tests.data import data_folder, models_folder
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.priors import modules

BOUNDS = (2.0, 6.0)
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")


def views(*levels: float) -> list[View]:
    """Grey pictures of 50x40 pixels, each camera 0.1 to the left of the one before."""
    found = []
    for index, level in enumerate(levels):
        pose = torch.eye(4, dtype=torch.float64)
        pose[0, 3] = 0.1 * index
        camera = Camera(pose, 45.0, 46.0, 26.0, 19.0, 50, 40)
        found.append(View(f"view{index}", camera, torch.full((40, 50, 3), level)))
    return found


def asked(path: Path, given: list[View], **settings: object) -> list[DepthMap]:
    return build(TorchModule, model=path, **settings).depths(given, BOUNDS)


def test_registers_as_torch_module() -> None:
    assert offered(stereogs_register_priors) == {"torch_module": TorchModule}


def test_a_list_of_images_the_reference_first(tmp_path: Path) -> None:
    path = modules.saved(tmp_path / "m.pt", modules.Mean())
    first, *_ = asked(path, views(0.9, 0.25, 0.75))
    assert first.depth.shape == (40, 50)
    assert torch.allclose(first.depth, torch.tensor(4.0))
    assert torch.allclose(first.confidence, torch.tensor(0.9))
    (nearest, *_) = asked(path, views(0.9, 0.25, 0.75), max_sources=1)
    assert torch.allclose(nearest.depth, torch.tensor(3.0))
    unsure = asked(path, views(0.9, 0.25, 0.75), min_confidence=0.5)
    assert [bool(answer.valid.any()) for answer in unsure] == [True, False, True]


@pytest.mark.parametrize(
    ("level", "settings", "expected"),
    [
        (0.0, {}, 45 * 64 / 50),
        (0.1, {}, 26 * 64 / 50 - 0.5),
        (0.1, {"pixel_centers": "half_integers", "multiple": 10}, 26),
        (0.2, {}, 19 * 32 / 40 - 0.5),
        (0.2, {"size": (100, 80)}, 19 * 2 - 0.5),
        (0.3, {}, 0.1),
        (0.4, {}, 2),
        (0.5, {}, 6),
    ],
)
def test_cameras_and_bounds_in_one_tensor_each(
    tmp_path: Path, level: float, settings: dict[str, object], expected: float
) -> None:
    path = modules.saved(tmp_path / "m.pt", modules.Numbers())
    first, _ = asked(path, views(level, level), **settings)
    assert torch.allclose(first.depth, torch.tensor(float(expected)))


def test_random_numbers_of_a_module_are_the_same_in_every_call(tmp_path: Path) -> None:
    prior = build(TorchModule, model=modules.saved(tmp_path / "m.pt", modules.Random()))
    state = torch.random.get_rng_state()
    one, other = (prior.estimate(views(0.5, 0.5), BOUNDS)[0].depth for _ in range(2))
    assert torch.equal(one, other)
    assert torch.equal(state, torch.random.get_rng_state())
    assert one.std() > 0.1


@pytest.mark.parametrize(
    ("module", "settings", "message"),
    [
        (modules.Other(), {}, "the module takes images, pose_encoding"),
        (modules.Strict(), {}, "the module failed"),
        (modules.Strict(), {"multiple": 64}, "'depth' has the shape"),
    ],
)
def test_other_modules_are_refused(
    tmp_path: Path, module: nn.Module, settings: dict[str, object], message: str
) -> None:
    path = modules.saved(tmp_path / "m.pt", module)
    with pytest.raises(PluginError, match=message):
        asked(path, views(0.5, 0.5), **settings)


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.pt").write_text("no module")
    with pytest.raises(PluginError, match="not a TorchScript module"):
        build(TorchModule, model=tmp_path / "text.pt")
    with pytest.raises(PluginError, match="cannot be read") as caught:
        build(TorchModule, model=tmp_path / "none.pt")
    assert "stereogs models" in caught.value.fix


@pytest.mark.proof
def test_patchmatchnet_on_dtu() -> None:
    """Half of the depths of the middle view are confirmed by another view within 1 %."""
    model = models_folder("patchmatchnet") / "patchmatchnet_dtu.pt"
    scene = build(DTUScene, path=data_folder("dtu_scan24")).load()
    prior = build(TorchModule, model=model, multiple=16)
    first, second, _ = prior.estimate(scene.train, scene.bounds)
    cameras = [view.camera for view in scene.train]
    u, v = cameras[0].pixel_centers()
    points = cameras[0].unproject(u.ravel(), v.ravel(), first.depth.double().ravel())
    column, row, depth = cameras[1].project(points)
    inside = cameras[1].contains(column, row)
    seen = second.depth[
        row.clamp(0, second.depth.shape[0] - 1).long(),
        column.clamp(0, second.depth.shape[1] - 1).long(),
    ]
    agree = inside & ((seen - depth).abs() < 0.01 * depth)
    mask = scene.train[0].mask
    assert mask is not None
    assert agree[mask.ravel()].float().mean() > 0.2
