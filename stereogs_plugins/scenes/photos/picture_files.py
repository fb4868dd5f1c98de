"""Photographs in a folder as written by phones and cameras.

Pictures may be in subfolders (DCIM/100CANON). Companion files of devices and editors (previews, films, edit
notes) are ignored, and so are hidden files and folders.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from registry import SceneError
from registry.toolkit.photos import HEIF_SUFFIXES, IMAGE_SUFFIXES, read_heif

UNREADABLE = (".avif", ".gif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf")
"""Suffixes of unsupported picture formats, which raise an error."""
_COMPANION_NAMES = ("thumbs.db", "ehthumbs.db", "desktop.ini", "picasa.ini", "icon\r")
_COMPANION_SUFFIXES = (
    ".aae",
    ".xmp",
    ".thm",
    ".ctg",
    ".lrv",
    ".mov",
    ".mp4",
    ".m4v",
    ".3gp",
    ".avi",
)
_COMPANION_FOLDERS = ("__macosx", "@eadir")


class FolderContent(NamedTuple):
    """Files of a folder and its subfolders, each kind sorted by path.

    Args:
        pictures: files in supported formats, including HEIC.
        unreadable: pictures in unsupported formats.
        companions: companion files of pictures.
        others: the rest.
    """

    pictures: list[Path]
    unreadable: list[Path]
    companions: list[Path]
    others: list[Path]

    @property
    def left_out(self) -> list[Path]:
        """Files that are not photographs."""
        return [*self.companions, *self.others]


def list_content(folder: Path) -> FolderContent:
    """Classify the files of a folder by name and suffix, without following links to folders."""
    content = FolderContent([], [], [], [])
    for place, folders, files in os.walk(folder):
        folders[:] = [
            f for f in folders if not f.startswith(".") and f.lower() not in _COMPANION_FOLDERS
        ]
        content.others.extend(Path(place, f) for f in folders if Path(place, f).is_symlink())
        for name in files:
            if not name.startswith("."):
                _kind(content, name).append(Path(place, name))
    for paths in content:
        paths.sort()
    return content


def _kind(content: FolderContent, name: str) -> list[Path]:
    suffix = Path(name).suffix.lower()
    if suffix in IMAGE_SUFFIXES or suffix in HEIF_SUFFIXES:
        return content.pictures
    if suffix in UNREADABLE:
        return content.unreadable
    if suffix in _COMPANION_SUFFIXES or name.lower() in _COMPANION_NAMES:
        return content.companions
    return content.others


def is_pictures_alone(folder: Path) -> bool:
    """Return True if a folder contains only pictures and their companion files."""
    content = list_content(folder)
    return bool(content.pictures or content.unreadable) and not content.others


def readable_pictures(folder: Path) -> list[Path]:
    """Photographs of a folder and its subfolders, sorted by path.

    Raises:
        SceneError: the folder is missing, or has pictures in an unsupported format.
    """
    if not folder.is_dir():
        raise SceneError(
            "the folder of photographs does not exist",
            where=str(folder),
            fix="set `path` to a folder with pictures",
        )
    content = list_content(folder)
    if content.unreadable:
        raise SceneError(
            f"pictures in unsupported formats: {_few(content.unreadable)}",
            where=str(folder),
            fix="convert them to JPEG or PNG, or remove them from the folder",
        )
    heif = [path for path in content.pictures if path.suffix.lower() in HEIF_SUFFIXES]
    if heif and not read_heif():
        raise SceneError(
            f"HEIC needs the package pillow-heif, which is not installed: {_few(heif)}",
            where=str(folder),
            fix="pip install 'stereogs-plugins[heic]', or convert them to JPEG",
        )
    return content.pictures


def _few(paths: list[Path]) -> str:
    """The first names, and the number of others."""
    names = ", ".join(path.name for path in paths[:3])
    return names if len(paths) <= 3 else f"{names} and {len(paths) - 3} more"
