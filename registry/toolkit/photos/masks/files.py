"""Find the masks of photographs by their names."""

from __future__ import annotations

import logging
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from unicodedata import normalize

from ....errors import SceneError
from ..reading import IMAGE_SUFFIXES, inside, list_images

_SUFFIXES = (*IMAGE_SUFFIXES, ".jfif", ".jpe")
_FOLDER = re.compile(r"masks?(_\d+)?", re.IGNORECASE)
_ENDING = re.compile(r"[._-]mask$", re.IGNORECASE)

_log = logging.getLogger("stereogs.photos")


def masks_beside(images: Path, photos: Sequence[Path]) -> list[Path | None]:
    """Return the mask of each photograph as `find_masks`; warn of masks that belong to none of them."""
    found = find_masks(images, photos)
    folders = [folder for folder in _mask_folders(images) if any(folder.rglob("*.*"))]
    if folders and not any(found):
        _log.warning(
            "the masks in %s are not used: none is named as a photograph, for example %s.png",
            *(folders[0], photos[0].name),
        )
    return found


def find_masks(images: Path, photos: Sequence[Path]) -> list[Path | None]:
    """Return the mask of each photograph, None where there is none.

    The mask of `images_2/a.jpg` is `a.jpg.png` (COLMAP), `a.png` (nerfstudio) or `a_mask.png` (Metashape), in
    `masks_2`, `masks` or `mask` beside or inside the folder of the photographs, or `a_mask.png` beside the
    photograph. For `images/cam1/a.jpg` it is in `masks/cam1` or `images/cam1/masks`.

    Args:
        images: Folder of the photographs.
        photos: Paths of the photographs in it or in its subfolders.

    Raises:
        SceneError: Two photographs have the same mask.
    """
    listed, folders = cache(list_images), cache(_mask_folders)
    found = [_mask_of(images, photo, listed, folders) for photo in photos]
    for mask, count in Counter(filter(None, found)).items():
        if count > 1:
            first, second, *_ = [
                photo.relative_to(images).as_posix()
                for photo, own in zip(photos, found, strict=True)
                if own == mask
            ]
            raise SceneError(
                f"the mask belongs to two photographs, {first} and {second}",
                where=str(mask),
                fix=f"name it {first}.png or {second}.png in the folder masks; `masks: false` ignores all",
            )
    return found


def is_mask_folder(path: Path) -> bool:
    """Return whether a folder's name says that it has masks: `masks`, `mask` or `masks_2`."""
    return bool(_FOLDER.fullmatch(path.name))


def are_masks(paths: Sequence[Path], folder: Path) -> list[bool]:
    """Return which pictures of a folder are masks by their folder or name; none if all would be."""
    photos = {(path.parent, _bare(path.name)) for path in paths if not _is_marked(path)}
    masks = [
        any(map(is_mask_folder, path.relative_to(folder).parents))
        or (_is_marked(path) and (path.parent, _bare(path.name)) in photos)
        for path in paths
    ]
    return [False] * len(paths) if all(masks) else masks


_List = Callable[[Path], list[Path]]


def _mask_of(images: Path, photo: Path, listed: _List, folders: _List) -> Path | None:
    bare = _bare(photo.name)
    for folder in _places(images, photo, folders):
        masks = [path for path in listed(folder) if _bare(path.name) == bare]
        if folder == photo.parent:
            masks = [path for path in masks if _is_marked(path) and path.name != photo.name]
        if masks:
            best = min(masks, key=lambda path: not path.name.startswith(f"{photo.name}."))
            return inside(folder, best.name, str(folder))
    return None


def _places(images: Path, photo: Path, folders: _List) -> Iterator[Path]:
    """Folders that may have the mask of a photograph."""
    for place in photo.parents:
        for folder in folders(place):
            yield folder / photo.parent.relative_to(place)
        if place == images:
            break
    yield photo.parent


def _mask_folders(images: Path) -> list[Path]:
    """Folders of masks beside and inside a folder of photographs, in whatever case."""
    names = (images.name.lower().replace("images", "masks", 1), "masks", "mask")
    inside_names = names[1:]
    found = [
        (names.index(path.name.lower()), path)
        for path in _folders(images.parent)
        if path.name.lower() in names and path.name != images.name
    ]
    return [path for _, path in sorted(found)] + [
        path for path in _folders(images) if path.name.lower() in inside_names
    ]


def _folders(place: Path) -> list[Path]:
    try:
        return sorted(path for path in place.iterdir() if path.is_dir())
    except OSError:  # not readable
        return []


def _is_marked(path: Path) -> bool:
    return _stripped(path.name) != _bare(path.name)


def _stripped(name: str) -> str:
    """Return `a` for `a.jpg` and `A.JPG.png`."""
    path = Path(normalize("NFC", name).lower())
    while path.suffix in _SUFFIXES:
        path = path.with_suffix("")
    return path.name


def _bare(name: str) -> str:
    """Return `a` for `a.jpg`, `a.jpg.png`, `a_mask.png` and `a.jpg.mask.png`."""
    return _stripped(_ENDING.sub("", _stripped(name)))
