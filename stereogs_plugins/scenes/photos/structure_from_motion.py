"""Cameras from photographs alone: COLMAP's structure from motion on the CPU.

SIFT (Lowe 2004), exhaustive matching, two-view geometry by RANSAC, then mapping.py. Where that does
not place every photograph, once more with domain-size pooling (Dong and Soatto 2015), whose
descriptors are known again from farther away and take several times as long. Random choices are
seeded, photographs are numbered before threads see them, and mapping runs on one thread: the result
does not depend on how threads take turns.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from PIL import Image

from registry.photos import Decoder, import_pycolmap, in_parallel

from .image_names import image_index, image_name
from .mapping import MAX_ERROR, SEED, Piece, place_cameras, worth

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .unposed_photos import UnposedPhoto

_log = logging.getLogger("stereogs.photos")


@dataclass(frozen=True)
class Reconstruction:
    """What came of it.

    Args:
        pieces: photographs that fit together; the best piece first.
        matches: numbers of matches that fit one two-view geometry, by pair of indices, first < second.
        features: the number of features of each photograph.
    """

    pieces: list[Piece]
    matches: dict[tuple[int, int], int]
    features: list[int]

    @property
    def rank(self) -> tuple[bool, int, int]:
        """What the better of two has more of: a plausible lens, photographs placed, matches."""
        return (*worth(self.pieces), sum(self.matches.values()))


def reconstruct(
    photos: Sequence[UnposedPhoto], decoder: Decoder, share_lens: bool, folder: Path
) -> Reconstruction:
    """Find cameras and points.

    Args:
        decoder: how photographs are read for this.
        share_lens: one lens for all photographs of one camera, size and focal length.
        folder: empty; takes the working files and the models.

    Raises:
        SceneError: a photograph is damaged.
    """
    # What it calls an error, that no model came of it, is explained here in other words.
    colmap = import_pycolmap(least_severity=3)
    images, database = folder / "images", folder / "matches.db"
    images.mkdir()
    _log.info("finding the cameras of %d photographs; this may take minutes", len(photos))
    # pycolmap is given files written here alone: a truncated photograph would end the process.
    in_parallel(
        lambda k: Image.fromarray(decoder.read(photos[k].path)).save(
            images / image_name(k), compress_level=1
        ),
        range(len(photos)),
    )
    lenses = _lenses(photos, share_lens)
    best: Reconstruction | None = None
    for name, pooled in (("plain", False), ("pooled", True)):
        workplace = folder / name
        workplace.mkdir()
        database = workplace / "matches.db"
        colmap.set_random_seed(SEED)
        colmap.Database.open(database).close()  # import_images wants it to exist
        for group in lenses:
            _import(colmap, database, images, group, photos[group[0]], decoder)
        _extract(colmap, database, images, pooled)
        found = _matched_and_placed(colmap, database, images, workplace, len(photos))
        if best is None or found.rank > best.rank:
            best = found
        if best.rank[:2] == (True, len(photos)):
            break
        _log.info("the cameras of %d of %d photographs fit together", best.rank[1], len(photos))
    assert best is not None
    return best


def _matched_and_placed(
    colmap: Any, database: Path, images: Path, folder: Path, count: int
) -> Reconstruction:
    _match(colmap, database)
    with colmap.Database.open(database) as opened:
        index = {image.image_id: image_index(image.name) for image in opened.read_all_images()}
        features = {index[k]: opened.num_keypoints_for_image(k) for k in index}
        matches = _verified_matches(colmap, opened, index)
    _log.info("matched %d pairs of photographs; placing the cameras", len(matches))
    pieces = place_cameras(colmap, database, images, folder, count)
    return Reconstruction(pieces, matches, [features[k] for k in range(count)])


def _lenses(photos: Sequence[UnposedPhoto], share_lens: bool) -> list[list[int]]:
    """Indices of the photographs that each lens took."""
    groups: dict[object, list[int]] = {}
    for index, photo in enumerate(photos):
        key = (photo.size, photo.camera, photo.focal) if share_lens else index
        groups.setdefault(key, []).append(index)
    return list(groups.values())


def _import(
    colmap: Any,
    database: Path,
    images: Path,
    group: list[int],
    photo: UnposedPhoto,
    decoder: Decoder,
) -> None:
    """Number the photographs of one lens, of which `photo` is one, before threads can."""
    reader = colmap.ImageReaderOptions(camera_model="SIMPLE_RADIAL")
    if photo.focal is not None:
        width, height = decoder.size(*photo.size)
        focal = photo.focal * max(width, height)
        reader.camera_params = f"{focal},{width / 2},{height / 2},0"
    colmap.import_images(
        database,
        images,
        camera_mode=colmap.CameraMode.SINGLE,
        image_names=[image_name(k) for k in group],
        options=reader,
    )


def _extract(colmap: Any, database: Path, images: Path, pooled: bool) -> None:
    options = colmap.FeatureExtractionOptions()
    options.sift.domain_size_pooling = pooled
    colmap.extract_features(database, images, extraction_options=options, device=colmap.Device.cpu)


def _match(colmap: Any, database: Path) -> None:
    geometry = colmap.TwoViewGeometryOptions()
    geometry.ransac.random_seed = SEED
    geometry.ransac.max_error = MAX_ERROR
    colmap.match_exhaustive(
        database,
        matching_options=colmap.FeatureMatchingOptions(),
        verification_options=geometry,
        device=colmap.Device.cpu,
    )


def _verified_matches(
    colmap: Any, database: Any, index: dict[int, int]
) -> dict[tuple[int, int], int]:
    pairs, geometries = database.read_two_view_geometries()
    found = {}
    for pair, geometry in zip(pairs, geometries, strict=True):
        first, second = sorted(index[image] for image in colmap.pair_id_to_image_pair(pair))
        if len(geometry.inlier_matches):
            found[first, second] = len(geometry.inlier_matches)
    return found
