"""Found cameras on disk, found again by the content of the photographs.

    STEREOGS_CACHE/cameras/<key>/   a COLMAP model

The key is a hash over the photographs, the settings, pycolmap's version and the code that computes the
model.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path

from registry.cache import Cache, content_key, source_digest
from registry.photos import ColmapModel, Decoder, longest_side, read_colmap_model

from .structure_from_motion import reconstruct
from .unposed_photos import UnposedPhoto

_FILES = ("cameras.bin", "images.bin", "points3D.bin")


def remembered_model(
    photos: Sequence[UnposedPhoto], treatment: str, compute: Callable[[Path], Path]
) -> ColmapModel:
    """The model that `compute` finds in an empty folder, from the cache if it is there.

    Args:
        treatment: all that the model depends on beside the photographs.
        compute: takes the empty folder, returns the model's folder inside.
    """
    kept = Cache("cameras")
    key = _key(photos, treatment)
    model = kept.load(key, _read)
    if model is not None:
        return model
    with tempfile.TemporaryDirectory(prefix="stereogs-") as name:
        found = compute(Path(name))
        model = _read(found)
        kept.save(key, lambda folder: [shutil.copy(found / file, folder) for file in _FILES])
    return model


def _key(photos: Sequence[UnposedPhoto], treatment: str) -> str:
    return content_key(
        treatment,
        version("pycolmap"),
        source_digest(reconstruct, UnposedPhoto, Decoder, longest_side),
        *(photo.digest for photo in photos),
    )


def _read(folder: Path) -> ColmapModel:
    return read_colmap_model(folder, "clear the cache folder")
