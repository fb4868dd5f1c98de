"""Photographs in a folder as written by phones and cameras.

Pictures may be in subfolders (DCIM/100CANON). Companion files of devices and editors (previews, films, edit
notes) are ignored, and so are hidden files and folders.
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from registry import SceneError
from registry.toolkit.photos import HEIF_SUFFIXES, IMAGE_SUFFIXES, are_masks, read_heif

UNREADABLE = (".avif", ".gif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf")
"""Suffixes of unsupported picture formats, which are left out."""
_PICTURES = (*IMAGE_SUFFIXES, ".jfif", ".jpe")
_COMPANION_NAMES = ("thumbs.db", "ehthumbs.db", "desktop.ini", "picasa.ini", "icon\r")
_VIDEOS = (".mov", ".mp4", ".m4v", ".3gp", ".avi")
_COMPANION_SUFFIXES = (".aae", ".xmp", ".thm", ".ctg", ".lrv", *_VIDEOS)
_COMPANION_FOLDERS = ("__macosx", "@eadir")
_RUN_FILES = {"pipeline.yaml", "provenance.json"}
"""Files of a folder that a training run wrote; its pictures are renders."""
_DATABASES = (".db", ".h5")
"""Suffixes of features and matches of COLMAP and hloc, which are found anew."""
_CAMERAS = (".xml", ".out", ".nvm", ".sfm", ".psx", ".rcproj", ".rsproj", ".mg")
"""Suffixes of cameras and projects of Metashape, Bundler, VisualSfM, RealityScan and Meshroom."""
_CAMERA_NAME = re.compile(
    r"(.*[^a-z])?(cams?|cameras?|poses?|intrinsics?|extrinsics?|trajectory)([^a-z].*)?",
    re.IGNORECASE,
)
"""Names of text files with cameras, as of MVSNet (00000000_cam), KITTI (poses) and RealityScan (cameras)."""
_DATA_SUFFIXES = (".json", ".npy", ".npz", ".bin", ".mat", ".exr", ".pfm")
_DATA_NAMES = ("cameras.txt", "images.txt", "points3d.txt")
"""Files of data sets, which other loaders read."""
COMPANION = "a companion file of pictures"
_MAX_NAMES, _MAX_LINES = 6, 12


class LeftOut(NamedTuple):
    """A file that is not used, and why."""

    path: Path
    reason: str


class FolderContent(NamedTuple):
    """Files of a folder and its subfolders, each kind sorted by path.

    Args:
        pictures: files in supported formats, including HEIC.
        unreadable: pictures in unsupported formats.
        companions: companion files of pictures.
        runs: folders of training runs, which are not searched.
        others: the rest.
    """

    pictures: list[Path]
    unreadable: list[Path]
    companions: list[Path]
    runs: list[Path]
    others: list[Path]


def list_content(folder: Path) -> FolderContent:
    """Classify the files of a folder by name and suffix, without following links to folders."""
    content = FolderContent([], [], [], [], [])
    for place, folders, files in os.walk(folder):
        if _RUN_FILES.issubset(files) and Path(place) != folder:
            content.runs.append(Path(place))
            folders.clear()
            continue
        folders[:] = [
            f for f in folders if not f.startswith(".") and f.lower() not in _COMPANION_FOLDERS
        ]
        content.others.extend(Path(place, f) for f in folders if Path(place, f).is_symlink())
        pictures = {name for name in files if _suffix(name) in _PICTURES}
        for name in files:
            if not name.startswith("."):
                _kind(content, name, pictures).append(Path(place, name))
    for paths in content:
        paths.sort()
    return content


def _suffix(name: str) -> str:
    return Path(name).suffix.lower()


def _kind(content: FolderContent, name: str, pictures: set[str]) -> list[Path]:
    """The list for a file of a folder with these pictures; IMG_1.jpg.json is a companion of IMG_1.jpg."""
    suffix = _suffix(name)
    if suffix in _PICTURES:
        return content.pictures
    if suffix in UNREADABLE:
        return content.unreadable
    if suffix in _COMPANION_SUFFIXES or name.lower() in _COMPANION_NAMES:
        return content.companions
    starts = itertools.accumulate(name.split("."), "{}.{}".format)
    if suffix == ".json" and not pictures.isdisjoint(starts):
        return content.companions
    return content.others


def is_picture_folder(folder: Path) -> bool:
    """Return True if a folder contains pictures, and neither files of a data set nor links to folders."""
    content = list_content(folder)
    return bool(content.pictures or content.unreadable) and not any(map(_is_data, content.others))


def _is_data(path: Path) -> bool:
    return (
        path.is_symlink()
        or path.suffix.lower() in _DATA_SUFFIXES
        or path.name.lower() in _DATA_NAMES
    )


def readable_pictures(folder: Path) -> tuple[list[Path], list[Path], list[LeftOut]]:
    """Photographs of a folder and its subfolders, sorted by path, their masks, and the other files.

    Raises:
        SceneError: the folder is missing.
    """
    if not folder.is_dir():
        raise SceneError(
            "the folder of photographs does not exist",
            where=str(folder),
            fix="set `path` to a folder with pictures",
        )
    content = list_content(folder)
    drawn = [path for path in content.pictures if path.suffix.lower() == ".png" and _drawn(path)]
    content.pictures[:] = [path for path in content.pictures if path not in drawn]
    marked = are_masks(content.pictures, folder)
    masks = list(itertools.compress(content.pictures, marked))
    content.pictures[:] = [path for path in content.pictures if path not in masks]
    without_suffix = {path.with_suffix("") for path in content.pictures}
    left_out = [LeftOut(path, COMPANION) for path in content.companions]
    left_out += [LeftOut(path, "the folder of a training run") for path in content.runs]
    left_out += [LeftOut(path, "drawn by `stereogs check`") for path in drawn]
    left_out += [LeftOut(path, _what(path)) for path in content.others]
    for path in content.unreadable:
        if path.with_suffix("") in without_suffix:
            left_out.append(LeftOut(path, "the folder has the same picture in a supported format"))
        else:
            left_out.append(LeftOut(path, "unsupported format; convert it to JPEG or PNG"))
    heif = [path for path in content.pictures if path.suffix.lower() in HEIF_SUFFIXES]
    if heif and not read_heif():
        reason = (
            "HEIC needs pillow-heif (pip install 'stereogs-plugins[heic]'), or convert it to JPEG"
        )
        left_out += [LeftOut(path, reason) for path in heif]
        content.pictures[:] = [path for path in content.pictures if path not in heif]
    return content.pictures, masks, left_out


def _what(path: Path) -> str:
    """What a file that is not a picture is."""
    suffix = path.suffix.lower()
    named = suffix in (".txt", ".csv") and _CAMERA_NAME.fullmatch(path.stem)
    if suffix in _CAMERAS or named:
        return "cameras of another program; export them for COLMAP to use them"
    return "a database of matches; they are found anew" if suffix in _DATABASES else "not a picture"


def _drawn(path: Path) -> bool:
    """Return whether a PNG file was drawn by a command of this program."""
    from PIL import Image

    from registry.toolkit.drawing import DRAWN

    try:
        with Image.open(path) as picture:
            return str(picture.info.get(DRAWN, "")).startswith("stereogs ")
    except (OSError, ValueError, SyntaxError):  # damaged: its decoding says so
        return False


def reason_lines(left_out: dict[int, str], names: Sequence[str]) -> list[str]:
    """Return a line for each reason, with the photographs that share it."""
    by_reason: dict[str, list[int]] = {}
    for index, reason in left_out.items():
        by_reason.setdefault(reason, []).append(index)
    return [f"  {listed(few, names)}: {reason}" for reason, few in by_reason.items()]


def left_out_lines(folder: Path, files: Sequence[LeftOut]) -> list[str]:
    """Return a line for each reason, with the files that share it, except files that belong to pictures.

    Of very many lines, the first ones and the number of the others.
    """
    told = [file for file in files if file.reason != COMPANION]
    names = [path.relative_to(folder).as_posix() for path, _ in told]
    lines = reason_lines({k: reason for k, (_, reason) in enumerate(told)}, names)
    lines = [line.strip() for line in lines]
    more = len(lines) - _MAX_LINES
    return [*lines[:_MAX_LINES], f"and {more} more"] if more > 1 else lines


def listed(group: Sequence[int], names: Sequence[str]) -> str:
    """Return the names; only the first ones if there are many."""
    shown = group if len(group) <= _MAX_NAMES else group[: _MAX_NAMES - 1]
    more = len(group) - len(shown)
    return ", ".join(names[k] for k in shown) + (f" and {more} more" if more else "")
