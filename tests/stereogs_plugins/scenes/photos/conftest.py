"""A room photographed from five places: as a folder of files, and as COLMAP sees it."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from PIL import Image, ImageOps

from registry import Scene
from registry.toolkit.drawing import to_bytes
from stereogs_plugins.scenes.photos.photogrammetry.colmap import image_name, read_model
from stereogs_plugins.scenes.procedural import ProceduralScene
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.scenes.photos.photographs import COUNT, SIDEWAYS, load

if TYPE_CHECKING:
    from stereogs_plugins.scenes.photos.photogrammetry.colmap import Model

ORIENTATION = 0x0112


@pytest.fixture(scope="package")
def room() -> Scene:
    """The procedural room from five places: the truth."""
    return build(
        ProceduralScene, train_views=COUNT, test_views=0, width=360, height=270, points=0
    ).load()


@pytest.fixture(scope="package")
def folder(room: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its photographs only, one of them stored sideways."""
    folder = tmp_path_factory.mktemp("photographs")
    for index, view in enumerate(room.train):
        exif = Image.Exif()
        picture = Image.fromarray(to_bytes(view.image))
        if index == SIDEWAYS:
            picture = picture.transpose(Image.Transpose.ROTATE_90)
            exif[ORIENTATION] = 6  # to be turned by 90 degrees clockwise
        picture.save(folder / f"{view.name}.jpg", quality=97, exif=exif)
    return folder


@pytest.fixture(scope="package")
def cache(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache with the cameras of `folder`, which the workers of pytest-xdist share."""
    own = tmp_path_factory.getbasetemp()
    cache = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "cache_of_photographs"
    cache.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch, (cache / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        patch.setenv("STEREOGS_CACHE", str(cache))
        load(folder)
    return cache


@pytest.fixture
def entry(cache: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The cameras of `folder` in a cache that loads use."""
    monkeypatch.setenv("STEREOGS_CACHE", str(cache))
    (entry,) = cache.glob("cameras/*")
    return entry


@pytest.fixture
def model(entry: Path) -> Model:
    """The cameras of `folder`."""
    return read_model(entry / "piece_0")


@pytest.fixture(scope="package")
def images(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The photographs of `folder`, upright and named by index."""
    images = tmp_path_factory.mktemp("images")
    for index, file in enumerate(sorted(folder.iterdir())):
        with Image.open(file) as opened:
            ImageOps.exif_transpose(opened).save(images / image_name(index))
    return images
