"""Photographs of a folder with their EXIF data, and their names in COLMAP models."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from registry import SceneError
from registry.toolkit.photos import Impression, Size, find_masks, open_8_bit, upright_size
from registry.toolkit.progress import in_parallel

from .photogrammetry.thresholds import EXIF_FOCAL_RANGE, MIN_PHOTOS
from .picture_files import LeftOut, left_out_lines, readable_pictures

if TYPE_CHECKING:
    from PIL import Image

_MAKE, _MODEL, _EXIF_BLOCK = 0x010F, 0x0110, 0x8769
_FOCAL_MM, _FOCAL_35MM, _PIXELS_WIDE = 0x920A, 0xA405, 0xA002
_FOCAL_PLANE_DENSITY, _FOCAL_PLANE_UNIT = 0xA20E, 0xA210
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0}
_ANIMATIONS = ("WEBP", "PNG")
"""Formats whose further pictures are frames; those of JPEG and TIFF are previews or sizes of the first."""
_COLOR_SIZE, _MAX_CHROMA = 32, 4
"""Size of the picture that is searched for colours, and largest difference of its channels in a grey one."""
_SHARPER = 1.05
"""Ratio of sharpness from which a picture is sharper than its copy, see `Impression.sharpness`."""
_DIAGONAL_35MM = math.hypot(36, 24)
"""Diagonal of a 35 mm frame in millimetres; equivalent focal lengths compare diagonals (CIPA DCG-001)."""


@dataclass(frozen=True)
class UnposedPhoto:
    """A picture file.

    Args:
        path: path of the file.
        name: path within the folder of photographs, with / between folders.
        size: `(width, height)` of the upright picture.
        turned: True if it is stored sideways, by EXIF.
        focal: focal length by EXIF in units of the longer side; None if unknown.
        camera: make and model by EXIF; empty if unknown.
        digest: hash of the file's bytes.
        transparent: True if some pixels are not opaque.
        grey: True if it has no colours.
        impression: recognizes copies.
        mask: image that is black where nothing is matched or trained; None: everything counts.
    """

    path: Path
    name: str
    size: Size
    turned: bool
    focal: float | None
    camera: str
    digest: str
    transparent: bool
    grey: bool
    impression: Impression = field(compare=False, repr=False)
    mask: Path | None = None


class PictureFolder(NamedTuple):
    """Content of a folder.

    Args:
        photos: photographs, sorted by path.
        left_out: the other files.
    """

    photos: list[UnposedPhoto]
    left_out: list[LeftOut]


def read_folder(folder: Path, *, with_masks: bool = True) -> PictureFolder:
    """Read the pictures in a folder and its subfolders, and find their masks (`find_masks`).

    Pictures that cannot be read are left out, and copies of others in whatever format, size and quality.

    Raises:
        SceneError: the folder is missing, or has fewer than three usable pictures, or two whose focal length
            is known by EXIF.
    """
    paths, masks, left_out = readable_pictures(folder)
    read = in_parallel(
        lambda path: _read(path, path.relative_to(folder).as_posix()), paths, stage="reading"
    )
    photos = [photo for photo in read if isinstance(photo, UnposedPhoto)]
    left_out += [file for file in read if isinstance(file, LeftOut)]
    photos, copies = _without_copies(photos)
    left_out += copies
    if with_masks:
        found = find_masks(folder, [photo.path for photo in photos])
        photos = [replace(photo, mask=mask) for photo, mask in zip(photos, found, strict=True)]
        unused = sorted({*masks}.difference(found))
        left_out += [LeftOut(mask, "a mask without a photograph of this name") for mask in unused]
    lens_known = all(photo.focal is not None for photo in photos)
    if len(photos) < (2 if lens_known else MIN_PHOTOS):
        what = (
            f"camera estimation needs at least {MIN_PHOTOS} photographs, or two with a focal length in "
            f"EXIF; the folder has {len(photos)}"
        )
        files = left_out_lines(folder, left_out)
        raise SceneError(
            "\n".join([what, *(f"  left out: {line}" for line in files)]),
            where=str(folder),
            fix="add photographs that overlap, taken from different places"
            + (", or convert those left out" if files else ""),
        )
    return PictureFolder(photos, left_out)


def _without_copies(photos: list[UnposedPhoto]) -> tuple[list[UnposedPhoto], list[LeftOut]]:
    """Return the best one of each photograph, and the others.

    The best has most pixels, then colours, then a focal length, then most bytes. A render, which is less
    sharp than the photograph of the same size, is not the best, whatever it has.
    """
    kept: list[UnposedPhoto] = []
    copies: list[tuple[UnposedPhoto, int]] = []
    for photo in sorted(photos, key=_worth):
        # A copy may be stored on its side.
        turns = [photo.impression.turned(quarters) for quarters in range(4)]
        place = next(
            (
                k
                for k, other in enumerate(kept)
                if photo.digest == other.digest
                or any(one.is_copy_of(other.impression) for one in turns)
            ),
            None,
        )
        if place is None:
            kept.append(photo)
            continue
        best = kept[place]
        of_one_kind = (photo.size, photo.grey) == (best.size, best.grey)
        if of_one_kind and photo.impression.sharpness > _SHARPER * best.impression.sharpness:
            kept[place], photo = photo, best
        copies.append((photo, place))
    left_out = [LeftOut(photo.path, _copy_of(kept[place], photo)) for photo, place in copies]
    return sorted(kept, key=lambda photo: photo.path), sorted(left_out)


def _worth(photo: UnposedPhoto) -> tuple[Any, ...]:
    """Order of copies, the best first."""
    width, height = photo.size
    size = photo.path.stat().st_size
    return -width * height, photo.grey, photo.focal is None, -size, len(photo.name), photo.name


def _copy_of(best: UnposedPhoto, photo: UnposedPhoto) -> str:
    width, height = photo.size
    smaller = f", of {width}x{height} pixels only" if photo.size != best.size else ""
    return f"a copy of {best.name}{smaller}"


def _read(path: Path, name: str) -> UnposedPhoto | LeftOut:
    try:
        with open_8_bit(path, "the photograph") as file:
            size = upright_size(file)
            turned = size != file.size
            exif = file.getexif()
            camera = " ".join(
                str(exif.get(tag, "")).strip("\0 ") for tag in (_MAKE, _MODEL)
            ).strip()
            focal = _focal_length(exif.get_ifd(_EXIF_BLOCK), file.size)
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
            if getattr(file, "is_animated", False) and file.format in _ANIMATIONS:
                return LeftOut(path, "an animation, not a photograph")
            impression = Impression.of(file)  # decodes it, which finds damage
            transparent = file.has_transparency_data and _has_clear_pixels(file)
    except SceneError as error:
        return LeftOut(path, error.what)
    return UnposedPhoto(
        path, name, size, turned, focal, camera, digest, transparent, _is_grey(file), impression
    )


def _is_grey(file: Image.Image) -> bool:
    small = file.convert("RGB").resize((_COLOR_SIZE, _COLOR_SIZE), reducing_gap=2)
    red, green, blue = (np.asarray(channel, dtype=int) for channel in small.split())
    return int(max(abs(red - green).max(), abs(green - blue).max())) <= _MAX_CHROMA


def _has_clear_pixels(file: Image.Image) -> bool:
    lowest, _ = file.convert("RGBA").getchannel("A").getextrema()
    return isinstance(lowest, int | float) and lowest < 255


def _focal_length(exif: dict[int, Any], size: Size) -> float | None:
    """Focal length in units of the longer side, from the 35 mm equivalent or the sensor's pixel density."""
    longer = max(size)
    equivalent, millimetres = _number(exif, _FOCAL_35MM), _number(exif, _FOCAL_MM)
    density, unit = _number(exif, _FOCAL_PLANE_DENSITY), exif.get(_FOCAL_PLANE_UNIT, 2)
    if equivalent:
        focal = equivalent / _DIAGONAL_35MM * math.hypot(*size) / longer
    elif millimetres and density and unit in _UNIT_MM:
        # The density refers to the original photograph, which may have been larger.
        taken = max(_number(exif, _PIXELS_WIDE) or longer, longer)
        focal = millimetres * density / _UNIT_MM[unit] / taken
    else:
        return None
    return focal if EXIF_FOCAL_RANGE[0] < focal < EXIF_FOCAL_RANGE[1] else None


def equivalent_focal(focal: float, size: Size) -> float:
    """35 mm equivalent, in millimetres, of a focal length in units of the longer side."""
    return focal * max(size) / math.hypot(*size) * _DIAGONAL_35MM


def _number(exif: dict[int, Any], tag: int) -> float | None:
    """The value of a tag if it is a positive finite number, otherwise None."""
    try:
        value = float(exif[tag])
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    return value if 0 < value < math.inf else None
