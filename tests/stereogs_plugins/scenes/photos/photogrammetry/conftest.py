"""A synthetic model with exact matches."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from registry.toolkit.photos import import_pycolmap

if TYPE_CHECKING:
    from stereogs_plugins.scenes.photos.photogrammetry.colmap import Model


@pytest.fixture
def synthetic(tmp_path: Path) -> tuple[Path, Model]:
    """A database of four photographs with exact matches, and their model."""
    colmap = import_pycolmap(3)
    colmap.set_random_seed(0)
    options = colmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 4
    options.num_points3D = 60
    path = tmp_path / "matches.db"
    with colmap.Database.open(path) as database:
        return path, colmap.synthesize_dataset(options, database)
