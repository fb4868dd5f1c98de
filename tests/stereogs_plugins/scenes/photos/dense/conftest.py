"""The photographs of `folder` as COLMAP sees them, and the model of their cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from PIL import Image, ImageOps

from registry.toolkit.photos import import_pycolmap
from stereogs_plugins.scenes.photos.unposed_photos import image_name


@pytest.fixture(scope="package")
def images(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The photographs of `folder`, upright and named by index."""
    images = tmp_path_factory.mktemp("images")
    for index, file in enumerate(sorted(folder.iterdir())):
        with Image.open(file) as opened:
            ImageOps.exif_transpose(opened).save(images / image_name(index))
    return images


@pytest.fixture
def model(cache: Path) -> Any:
    (entry,) = (cache / "cameras").iterdir()
    return import_pycolmap(3).Reconstruction(entry / "piece_0")
