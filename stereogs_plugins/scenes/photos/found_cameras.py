"""Cache of estimated cameras, by the content of the photographs.

    STEREOGS_CACHE/cameras/<key>/found.json   pieces, matches, features
                                 piece_0/     COLMAP model of the best piece; piece_1/ ... the others

The key is a hash of the photographs, the settings, pycolmap's version and the code of the reconstruction.
Partial and failed reconstructions are kept too.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from registry.toolkit.cache import Cache, content_key, source_digest
from registry.toolkit.networks import KeypointNetworks
from registry.toolkit.photos import ColmapModel, Decoder, longest_side, read_colmap_model

from .dense.check import DenseCheck
from .dense.matches import dense_matches
from .dense.refinement import refine
from .dense.views import View
from .learned_matches import add_learned_matches
from .mapping import Piece, place_cameras
from .no_depth import doubt_of
from .structure_from_motion import Reconstruction, reconstruct
from .unposed_photos import UnposedPhoto

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_SUMMARY = "found.json"
_FILES = ("cameras.bin", "images.bin", "points3D.bin")


class FoundCameras(NamedTuple):
    """A reconstruction and the model of its best piece, None without pieces.

    The folders of the pieces may have been deleted.
    """

    reconstruction: Reconstruction
    model: ColmapModel | None


def remembered_cameras(
    photos: Sequence[UnposedPhoto], treatment: str, compute: Callable[[Path], Reconstruction]
) -> FoundCameras:
    """Return the cached result, or run `compute` and cache its result.

    Args:
        treatment: everything other than the photographs that the result depends on.
        compute: takes an empty folder for the models.
    """
    kept = Cache("cameras")
    key = _key(photos, treatment)
    found = kept.load(key, _read)
    if found is not None:
        return found
    with tempfile.TemporaryDirectory(prefix="stereogs-") as name:
        reconstruction = compute(Path(name))
        kept.save(key, lambda folder: _write(reconstruction, folder))
        return FoundCameras(reconstruction, _model(reconstruction))


def _key(photos: Sequence[UnposedPhoto], treatment: str) -> str:
    return content_key(
        treatment,
        version("pycolmap"),
        source_digest(
            reconstruct,
            place_cameras,
            DenseCheck,
            View,
            dense_matches,
            refine,
            doubt_of,
            add_learned_matches,
            KeypointNetworks,
            UnposedPhoto,
            Decoder,
            longest_side,
        ),
        *(photo.digest for photo in photos),
    )


def _write(found: Reconstruction, folder: Path) -> None:
    for number, piece in enumerate(found.pieces):
        target = folder / f"piece_{number}"
        target.mkdir()
        for file in _FILES:
            shutil.copy(piece.folder / file, target)
    summary = {
        "pieces": [
            {k: v for k, v in piece._asdict().items() if k != "folder"} for piece in found.pieces
        ],
        "matches": [[*pair, count] for pair, count in found.matches.items()],
        "features": found.features,
        "tried": found.tried,
        "doubts": [[*pair, doubt] for pair, doubt in found.doubts.items()],
        "ignores_exif": found.ignores_exif,
    }
    (folder / _SUMMARY).write_text(json.dumps(summary), "utf-8")


def _read(folder: Path) -> FoundCameras:
    summary = json.loads((folder / _SUMMARY).read_bytes())
    pieces = [
        Piece(folder / f"piece_{number}", **piece) for number, piece in enumerate(summary["pieces"])
    ]
    matches = {(first, second): count for first, second, count in summary["matches"]}
    doubts = {(first, second): doubt for first, second, doubt in summary["doubts"]}
    reconstruction = Reconstruction(
        pieces=pieces,
        matches=matches,
        features=summary["features"],
        tried=tuple(summary["tried"]),
        doubts=doubts,
        ignores_exif=summary["ignores_exif"],
    )
    return FoundCameras(reconstruction, _model(reconstruction))


def _model(found: Reconstruction) -> ColmapModel | None:
    if not found.pieces:
        return None
    return read_colmap_model(found.pieces[0].folder, "clear the cache folder")
