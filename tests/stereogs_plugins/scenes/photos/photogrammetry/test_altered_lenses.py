"""Zoomed and cropped photographs get their own lens."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from stereogs_plugins.scenes.photos.photogrammetry.altered_lenses import (
    with_cropped_lenses,
    with_zoomed_lenses,
)
from stereogs_plugins.scenes.photos.photogrammetry.colmap import index_of, lens_of, read_model
from stereogs_plugins.scenes.photos.unposed_photos import read_folder
from tests.data import data_folder
from tests.stereogs_plugins.scenes.photos.photographs import reconstruct

if TYPE_CHECKING:
    from stereogs_plugins.scenes.photos.photogrammetry.colmap import Model


@pytest.mark.proof
def test_zoomed_and_cropped_photographs_get_their_own_lens(model: Model) -> None:
    assert with_zoomed_lenses(model) is model
    assert with_cropped_lenses(model) is model
    first = min(model.reg_image_ids())
    (lens,) = model.cameras.values()
    middle = np.array([lens.width, lens.height]) / 2
    for point in model.image(first).points2D:
        point.xy = middle + 1.4 * (point.xy - middle)
    own = with_zoomed_lenses(model)
    focals = {k: lens_of(own, k).focal_length for k in own.reg_image_ids()}
    assert len(own.cameras) == 2
    assert focals.pop(first) / max(focals.values()) == pytest.approx(1.4, rel=0.02)

    assert with_cropped_lenses(own) is own
    shift = np.array([0.15, 0.1]) * lens.width
    for point in own.image(first).points2D:
        point.xy = point.xy + shift
    cropped = with_cropped_lenses(own)
    centres = {k: lens_of(cropped, k).params[1:3] for k in cropped.reg_image_ids()}
    assert centres.pop(first) - middle == pytest.approx(shift, abs=0.01 * lens.width)
    assert max(abs(centre - middle).max() for centre in centres.values()) == 0


@pytest.mark.proof
def test_an_enlarged_corner_gets_its_own_principal_point(tmp_path: Path) -> None:
    """Five of llff_room, the last without its left and lower quarters, enlarged to the size of the others."""
    every = sorted((data_folder("llff_room") / "images_8").iterdir())[13:18]
    (tmp_path / "in").mkdir()
    for number, path in enumerate(every):
        with Image.open(path) as opened:
            width, height = opened.size
            box = (width // 4, 0, width, height * 3 // 4) if number == 4 else None
            opened.resize((width, height), box=box).save(tmp_path / "in" / path.name)
    (piece,) = reconstruct(read_folder(tmp_path / "in").photos, tmp_path / "out").pieces
    assert piece.members == [0, 1, 2, 3, 4]
    assert piece.altered == (4,)
    model = read_model(piece.folder)
    (lens,) = (lens_of(model, k) for k in model.reg_image_ids() if index_of(model, k) == 4)
    centre = lens.params[1:3] / [lens.width, lens.height]
    assert centre == pytest.approx([1 / 3, 2 / 3], abs=0.03)
