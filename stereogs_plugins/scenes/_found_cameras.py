"""Found cameras on disk, found again by the content of the photographs.

    STEREOGS_CACHE/cameras/<key>/   a COLMAP model, and its checksum; deleting any of it is safe

The key is a hash over the photographs, the settings, pycolmap's version and the code that computes the
model.
"""

from __future__ import annotations

import hashlib
import logging
import shutil
import tempfile
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path

from registry import SceneError, cache_folder

from ._colmap_model import ColmapModel, read_model
from ._unposed_photos import UnposedPhoto

_FILES = ("cameras.bin", "images.bin", "points3D.bin")
_CHECKSUM = "checksum.txt"
_CODE = ("_structure_from_motion.py", "_unposed_photos.py", "_images.py")
_FIX = "clear the cache folder"
_log = logging.getLogger(__name__)


def remembered_model(
    photos: Sequence[UnposedPhoto], treatment: str, compute: Callable[[Path], Path]
) -> ColmapModel:
    """The model that `compute` finds in an empty folder, from the cache if it is there.

    Args:
        treatment: all that the model depends on beside the photographs.
        compute: takes the empty folder, returns the model's folder inside.
    """
    cache = cache_folder("cameras")
    kept = cache / _key(photos, treatment) if cache is not None else None
    if kept is not None and kept.is_dir():
        model = _read_kept(kept)
        if model is not None:
            return model
    with tempfile.TemporaryDirectory(prefix="stereogs-") as name:
        found = compute(Path(name))
        model = read_model(found, _FIX)
        if kept is not None:
            _keep(found, kept)
    return model


def _key(photos: Sequence[UnposedPhoto], treatment: str) -> str:
    digest = hashlib.sha256(f"{treatment}\0pycolmap {version('pycolmap')}".encode())
    for photo in photos:
        digest.update(f"\0{photo.digest}".encode())
    for name in _CODE:
        digest.update(Path(__file__).with_name(name).read_bytes())
    return digest.hexdigest()[:32]


def _read_kept(kept: Path) -> ColmapModel | None:
    try:
        if (kept / _CHECKSUM).read_text("utf-8") == _checksum(kept):
            return read_model(kept, _FIX)
        problem = "its checksum is another"
    except (OSError, ValueError, SceneError) as error:
        problem = str(error)
    _log.warning("the cached cameras %s are damaged (%s); finding them anew", kept, problem)
    shutil.rmtree(kept, ignore_errors=True)
    return None


def _keep(found: Path, kept: Path) -> None:
    """Write all or nothing. A full or read-only disk is reported; loading goes on without."""
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=kept.parent, prefix=".partial") as name:
            folder = Path(name, "model")
            folder.mkdir()
            for file in _FILES:
                shutil.copyfile(found / file, folder / file)
            (folder / _CHECKSUM).write_text(_checksum(folder), "utf-8")
            folder.rename(kept)
    except OSError as error:
        if not (kept / _CHECKSUM).is_file():  # else another process was first
            _log.warning("the found cameras could not be cached: %s", error)


def _checksum(folder: Path) -> str:
    digest = hashlib.sha256()
    for name in _FILES:
        digest.update((folder / name).read_bytes())
    return digest.hexdigest()
