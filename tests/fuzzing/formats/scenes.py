"""Data sets: cameras, names and points of all loaders of real photographs."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from PIL import Image

from registry import Scene, SceneLoader
from stereogs_plugins.scenes.blender import BlenderScene
from stereogs_plugins.scenes.colmap import ColmapScene
from stereogs_plugins.scenes.dtu import DTUScene
from stereogs_plugins.scenes.llff import LLFFScene
from stereogs_plugins.scenes.nerfstudio import NerfstudioScene
from tests.fuzzing.damage import OUTSIDE
from tests.fuzzing.target import Target
from tests.host import TEST_VIEWS, TRAIN_VIEWS
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.scenes.small_scenes import (
    DTU_VIEWS,
    World,
    write_blender,
    write_colmap,
    write_dtu,
    write_llff,
    write_nerfstudio,
)

PINK = (255, 0, 255)
SMALL = World(width=8, height=6)
SMALL_DTU = World(count=DTU_VIEWS, width=8, height=6)
BENT = World(width=8, height=6, distortion=(0.05, 0.01, 0.001, 0.0))
_MODEL = ("cameras", "images", "points3D")


class SceneFiles(Target):
    """A data set: loader with settings, writer, files to damage."""

    loader: ClassVar[type[SceneLoader[Any]]]
    settings: ClassVar[dict[str, Any]] = {}
    writer: ClassVar[Any]
    damaged: ClassVar[tuple[str, ...]]

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self._component = build(self.loader, path=folder / "scene", **self.settings)
        self._most = len(self._component.load().train)

    def write(self) -> tuple[str, ...]:
        """Write the data set, and a pink image outside it."""
        type(self).writer(self.folder / "scene")
        Image.new("RGB", (8, 6), PINK).save(self.folder / OUTSIDE)
        return tuple(f"scene/{file}" for file in self.damaged)

    def read(self) -> None:
        """Load it and check the scene."""
        scene = self._component.load()
        assert len(scene.train) <= self._most
        _check_scene(scene)


def _check_scene(scene: Scene) -> None:
    assert 0 < scene.bounds[0] < scene.bounds[1] < float("inf")
    for view in (*scene.train, *scene.test):
        camera, image = view.camera, view.image
        pose = camera.world_to_camera.numpy()
        rotation = pose[:3, :3]
        assert np.isfinite(pose).all()
        assert np.abs(rotation @ rotation.T - np.eye(3)).max() <= 1e-4
        assert np.linalg.det(rotation) > 0
        assert np.isfinite([camera.fx, camera.fy, camera.cx, camera.cy]).all()
        assert min(camera.fx, camera.fy) > 0
        assert image.shape == (camera.height, camera.width, 3)
        assert not np.allclose(image.numpy(), np.array(PINK) / 255), "a picture from outside"
        assert "/" not in view.name
        assert "\\" not in view.name
        assert view.name.isprintable()
    if scene.points is not None:
        assert np.isfinite(scene.points.positions.numpy()).all()


class Llff(SceneFiles):
    """`poses_bounds.npy` and points."""

    name = "llff"
    loader, settings = LLFFScene, {"downsample": 2}
    writer = staticmethod(lambda folder: write_llff(folder, SMALL))
    damaged = ("poses_bounds.npy", "points3d.npz")


class Blender(SceneFiles):
    """`transforms_train.json` and the other splits."""

    name = "blender"
    loader, settings = BlenderScene, {"train_ids": (1, 3, 5)}
    writer = staticmethod(lambda folder: write_blender(folder, SMALL))
    damaged = ("transforms_train.json", "transforms_test.json")


class Nerfstudio(SceneFiles):
    """`transforms.json`."""

    name = "nerfstudio"
    loader = NerfstudioScene
    writer = staticmethod(lambda folder: write_nerfstudio(folder, BENT))
    damaged = ("transforms.json",)


def _write_dtu(folder: Path) -> None:
    """Write a scan with only the cameras that are read, to save time."""
    path = write_dtu(folder, SMALL_DTU) / "cameras_sphere.npz"
    with np.load(path) as data:
        read = [
            n for n in data.files if int(n.rpartition("_")[2]) in (*TRAIN_VIEWS[:3], *TEST_VIEWS)
        ]
        kept = {name: data[name] for name in read}
    np.savez(path, **kept)


class Dtu(SceneFiles):
    """`cameras_sphere.npz`, without masks, which would take most of the time."""

    name = "dtu"
    loader, settings = DTUScene, {"masks": False}
    writer = staticmethod(_write_dtu)
    damaged = ("cameras_sphere.npz",)


class ColmapBinary(SceneFiles):
    """A COLMAP model in binary."""

    name = "colmap binary"
    loader = ColmapScene
    writer = staticmethod(lambda folder: write_colmap(folder, BENT))
    damaged = tuple(f"sparse/0/{name}.bin" for name in _MODEL)


class ColmapText(SceneFiles):
    """A COLMAP model as text."""

    name = "colmap text"
    loader = ColmapScene
    writer = staticmethod(
        lambda folder: write_colmap(folder, SMALL, text=True, model="PINHOLE"),
    )
    damaged = tuple(f"sparse/0/{name}.txt" for name in _MODEL)


SCENES: tuple[type[Target], ...] = (Llff, Blender, Nerfstudio, Dtu, ColmapBinary, ColmapText)
