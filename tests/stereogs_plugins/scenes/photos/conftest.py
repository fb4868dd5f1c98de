"""A room photographed from five places, as a folder of files."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from registry import Scene
from registry.toolkit.drawing import to_bytes
from stereogs_plugins.scenes.procedural import ProceduralScene
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.scenes.photos.photographs import COUNT, SIDEWAYS, load

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
    """A cache with the cameras of `folder`."""
    cache = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STEREOGS_CACHE", str(cache))
        load(folder)
    return cache


@pytest.fixture
def cached(cache: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("STEREOGS_CACHE", str(cache))
    return cache
