"""Which files of a folder are photographs, as phones and cameras fill folders.

Pictures may lie in folders within (DCIM/100CANON); what devices and editors put beside them is known
and left out: previews, films, notes about edits. Hidden files and folders are not looked at.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from registry import SceneError
from registry.toolkit.photos import HEIF_SUFFIXES, IMAGE_SUFFIXES, read_heif

UNREADABLE = (".avif", ".gif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf")
"""Endings of pictures that are not read here, and must not be left out in silence."""
_BESIDE_NAMES = ("thumbs.db", "ehthumbs.db", "desktop.ini", "picasa.ini", "icon\r")
_BESIDE_SUFFIXES = (".aae", ".xmp", ".thm", ".ctg", ".lrv", ".mov", ".mp4", ".m4v", ".3gp", ".avi")
_BESIDE_FOLDERS = ("__macosx", "@eadir")


class FolderContent(NamedTuple):
    """The files of a folder and the folders within, each kind sorted by path.

    Args:
        pictures: files that can be read, HEIC among them.
        unreadable: pictures of a kind that is not read.
        beside: what comes with pictures and is none.
        others: the rest.
    """

    pictures: list[Path]
    unreadable: list[Path]
    beside: list[Path]
    others: list[Path]

    @property
    def left_out(self) -> list[Path]:
        """What is no photograph."""
        return [*self.beside, *self.others]


def list_content(folder: Path) -> FolderContent:
    """What a folder holds, told by names and endings; what links lead to is not looked at."""
    content = FolderContent([], [], [], [])
    for place, folders, files in os.walk(folder):
        folders[:] = [
            f for f in folders if not f.startswith(".") and f.lower() not in _BESIDE_FOLDERS
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
    if suffix in _BESIDE_SUFFIXES or name.lower() in _BESIDE_NAMES:
        return content.beside
    return content.others


def is_pictures_alone(folder: Path) -> bool:
    """Whether a folder holds pictures and nothing but what comes with them."""
    content = list_content(folder)
    return bool(content.pictures or content.unreadable) and not content.others


def readable_pictures(folder: Path) -> list[Path]:
    """The photographs of a folder and the folders within, sorted by path.

    Raises:
        SceneError: there is no such folder, or it has pictures of a kind that cannot be read here.
    """
    if not folder.is_dir():
        raise SceneError(
            "the folder of photographs does not exist",
            where=str(folder),
            fix="set `path` to a folder that holds pictures",
        )
    content = list_content(folder)
    if content.unreadable:
        raise SceneError(
            f"there are pictures of a kind that is not read: {_few(content.unreadable)}",
            where=str(folder),
            fix="convert them to JPEG or PNG, or take them out of the folder",
        )
    heif = [path for path in content.pictures if path.suffix.lower() in HEIF_SUFFIXES]
    if heif and not read_heif():
        raise SceneError(
            f"HEIC is read by the package pillow-heif, which is not installed: {_few(heif)}",
            where=str(folder),
            fix="pip install 'stereogs-plugins[heic]', or convert them to JPEG",
        )
    return content.pictures


def _few(paths: list[Path]) -> str:
    """The first names, and how many more there are."""
    names = ", ".join(path.name for path in paths[:3])
    return names if len(paths) <= 3 else f"{names} and {len(paths) - 3} more"
