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
from typing import TYPE_CHECKING, Any, NamedTuple

from registry.toolkit.cache import Cache, content_key, source_digest
from registry.toolkit.networks import KeypointNetworks
from registry.toolkit.photos import ColmapModel, Decoder, longest_side, read_colmap_model, read_mask

from .photogrammetry.mapping import Piece, placed
from .photogrammetry.structure_from_motion import Reconstruction
from .unposed_photos import UnposedPhoto

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from registry.priors import PosedDepthPrior

_SUMMARY = "found.json"
_FILES = ("cameras.bin", "images.bin", "points3D.bin")


class FoundCameras(NamedTuple):
    """A reconstruction and the model of its best piece, None without pieces.

    The folders of the pieces may have been deleted.

    Args:
        prior: the one whose cameras were refined; None: cameras by matches alone.
    """

    reconstruction: Reconstruction
    model: ColmapModel | None
    prior: PosedDepthPrior[Any] | None = None

    @property
    def placed(self) -> int:
        """Number of photographs in the best piece."""
        return placed(self.reconstruction.pieces)


def remembered_cameras(
    photos: Sequence[UnposedPhoto],
    treatment: Callable[[], str],
    compute: Callable[[Path], Reconstruction],
) -> FoundCameras:
    """Return the cached result, or run `compute` and cache its result.

    Args:
        treatment: returns everything other than the photographs that the result depends on. If it changes
            while `compute` runs, which may open a network, nothing is cached.
        compute: takes an empty folder for the models.
    """
    kept = Cache("cameras")
    key = _key(photos, treatment())
    found = kept.load(key, _read)
    if found is not None:
        return found
    with tempfile.TemporaryDirectory(prefix="stereogs-") as name:
        reconstruction = compute(Path(name))
        if _key(photos, treatment()) == key:
            kept.save(key, lambda folder: _write(reconstruction, folder))
        return FoundCameras(reconstruction, _model(reconstruction))


def are_remembered(photos: Sequence[UnposedPhoto], treatment: str) -> bool:
    """Whether the result of `remembered_cameras` is cached."""
    return Cache("cameras").load(_key(photos, treatment), Path.is_dir) is not None


def _key(photos: Sequence[UnposedPhoto], treatment: str) -> str:
    code = sorted(Path(__file__).with_name("photogrammetry").rglob("*.py"))
    return content_key(
        treatment,
        version("pycolmap"),
        *(path.read_bytes() for path in code),
        source_digest(KeypointNetworks, UnposedPhoto, Decoder, longest_side, read_mask),
        *(photo.digest for photo in photos),
        *(b"" if photo.mask is None else photo.mask.read_bytes() for photo in photos),
    )


def _write(found: Reconstruction, folder: Path) -> None:
    for number, piece in enumerate(found.pieces):
        target = folder / f"piece_{number}"
        target.mkdir()
        for file in _FILES:
            shutil.copy(piece.folder / file, target)
    summary = vars(found) | {
        "pieces": [piece._replace(folder=Path())._asdict() for piece in found.pieces],
        "matches": [*found.matches.items()],
        "doubts": [*found.doubts.items()],
    }
    (folder / _SUMMARY).write_text(json.dumps(summary, default=str), "utf-8")


def _read(folder: Path) -> FoundCameras:
    summary = json.loads((folder / _SUMMARY).read_bytes())
    summary["pieces"] = [
        Piece(**piece | {"folder": folder / f"piece_{number}"})
        for number, piece in enumerate(summary["pieces"])
    ]
    for pairs in ("matches", "doubts"):
        summary[pairs] = {(first, second): value for (first, second), value in summary[pairs]}
    reconstruction = Reconstruction(**summary | {"tried": tuple(summary["tried"])})
    return FoundCameras(reconstruction, _model(reconstruction))


def _model(found: Reconstruction) -> ColmapModel | None:
    if not found.pieces:
        return None
    return read_colmap_model(found.pieces[0].folder, "clear the cache folder")
