"""Masks of photographs: found by name, in the photograph's orientation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from registry import SceneError
from registry.toolkit.photos import find_masks, read_mask
from registry.toolkit.photos.decoder import turned_by

LAYOUTS = {
    "colmap": ("images/a.jpg", "masks/a.jpg.png"),
    "nerfstudio": ("images/a.jpg", "masks/a.png"),
    "reduced": ("images_2/a.jpg", "masks_2/a.jpg.png"),
    "rig": ("images/left/a.jpg", "masks/left/a.jpg.png"),
    "beside each camera": ("images/left/a.jpg", "images/left/masks/a.png"),
    "other case": ("images/IMG_1.JPG", "masks/img_1.jpg.png"),
    "converted": ("images/a.heic", "masks/a.png"),
    "metashape": ("images/a.jpg", "masks/a_mask.png"),
    "realityscan": ("images/a.jpg", "images/a.jpg.mask.png"),
    "capital": ("images/a.jpg", "Masks/a.jpg.png"),
    "singular": ("images/a.jpg", "mask/a.png"),
    "decomposed accents": ("images/caf\u00e9.jpg", "masks/cafe\u0301.png"),
    "dots": ("images/a.1.jpg", "masks/a.1.jpg.png"),
}


def touch(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_mask_is_found_by_its_name(layout: str, tmp_path: Path) -> None:
    photo, mask = (touch(tmp_path / name) for name in LAYOUTS[layout])
    other = touch(photo.with_name(f"b{photo.suffix}"))
    images = tmp_path / LAYOUTS[layout][0].split("/")[0]
    assert find_masks(images, [photo, other]) == [mask, None]


def test_of_several_masks_the_one_with_the_whole_name_is_taken(tmp_path: Path) -> None:
    photos = [touch(tmp_path / "images" / f"a.{suffix}") for suffix in ("jpg", "png")]
    masks = [touch(tmp_path / "masks" / f"{photo.name}.png") for photo in photos]
    assert find_masks(tmp_path / "images", photos) == masks
    masks[0].unlink()
    with pytest.raises(SceneError, match=r"two photographs, a\.jpg and a\.png"):
        find_masks(tmp_path / "images", photos)


def stored(upright: NDArray[np.uint8], orientation: int) -> Image.Image:
    """The image that `turned_by` turns upright."""
    inverse = {6: 8, 8: 6}.get(orientation, orientation)
    return turned_by(Image.fromarray(upright), inverse)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("width", [8, 6])
def test_a_mask_is_turned_like_its_photograph_where_its_shape_or_exif_says_so(
    orientation: int, width: int, tmp_path: Path
) -> None:
    upright = np.full((6, width), 255, np.uint8)
    upright[:2, :3] = 0
    path = tmp_path / "mask.png"

    def read() -> NDArray[np.uint8]:
        mask, rule = read_mask(path, (width, 6), orientation=orientation)
        assert ("as the photograph is shown" in rule) == (as_shown and orientation != 1)
        return mask

    as_shown = True
    Image.fromarray(upright).save(path)
    np.testing.assert_array_equal(read(), upright)
    as_shown = False
    exif = Image.Exif()
    exif[0x0112] = orientation
    stored(upright, orientation).save(path, exif=exif)
    np.testing.assert_array_equal(read(), upright)
    if orientation > 4 and width != 6:
        stored(upright, orientation).save(path)
        np.testing.assert_array_equal(read(), upright)
