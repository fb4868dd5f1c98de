"""Cameras from photographs alone: COLMAP's structure from motion on the CPU.

SIFT (Lowe 2004), exhaustive matching, two-view geometry by RANSAC, then mapping.py. Where that does
not place every photograph, once more with domain-size pooling (Dong and Soatto 2015), whose
descriptors are known again from farther away and take several times as long; and where that does not
either, with the matches of two networks beside (learned_matches.py), if their files are there. Random
choices are seeded, photographs are numbered before threads see them, and mapping runs on one thread:
the result does not depend on how threads take turns.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from PIL import Image

from registry.photos import Decoder, import_pycolmap, in_parallel

from .learned_matches import FEWEST, add_learned_matches, known_files
from .mapping import MAX_ERROR, SEED, Piece, place_cameras, worth
from .unposed_photos import image_index, image_name

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from .unposed_photos import UnposedPhoto

MATCHES = "matches.db"
_log = logging.getLogger("stereogs.photos")


@dataclass(frozen=True)
class Reconstruction:
    """What came of it.

    Args:
        pieces: photographs that fit together; the best piece first.
        matches: numbers of matches that fit one two-view geometry, by pair of indices, first < second.
        features: the number of features of each photograph.
        tried: kinds of matches that cameras were looked for with, for people.
    """

    pieces: list[Piece]
    matches: dict[tuple[int, int], int]
    features: list[int]
    tried: tuple[str, ...] = ("SIFT",)

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
    images = folder / "images"
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
    tried: list[str] = []
    for name, fewest, fill in _ways(colmap, images, folder):
        workplace = folder / name
        workplace.mkdir()
        database = workplace / MATCHES
        colmap.set_random_seed(SEED)
        colmap.Database.open(database).close()  # import_images wants it to exist
        for group in lenses:
            _import(colmap, database, images, group, photos[group[0]], decoder)
        fill(database)
        tried.append(name)
        found = _placed(colmap, database, images, workplace, len(photos))
        found = replace(found, pieces=[p for p in found.pieces if len(p.members) >= fewest])
        # Matches that place nobody say little, those of noise included.
        if best is None or (found.pieces and found.rank > best.rank):
            best = found
        if best.rank[:2] == (True, len(photos)):
            break
        _log.info("%s: the cameras of %d of %d photographs fit together", name, *_share(found))
    assert best is not None
    return replace(best, tried=tuple(tried))


def _ways(colmap: Any, images: Path, folder: Path) -> list[tuple[str, int, Callable[[Path], None]]]:
    """The kinds of matches, the cheapest first: name, photographs that a piece of theirs needs to
    be believed, and what fills a database with them."""

    def by_sift(pooled: bool) -> Callable[[Path], None]:
        def fill(database: Path) -> None:
            _extract(colmap, database, images, pooled)
            _match(colmap, database)

        return fill

    ways = [("SIFT", 2, by_sift(False)), ("pooled SIFT", 2, by_sift(True))]
    files = known_files()
    if files is not None:

        def by_networks(database: Path) -> None:
            add_learned_matches(colmap, files, images, folder / ways[0][0] / MATCHES, database)
            colmap.geometric_verification(database, two_view_geometry_options=_geometry(colmap))

        ways.append(("SIFT with XFeat and LighterGlue", FEWEST, by_networks))
    return ways


def _share(found: Reconstruction) -> tuple[int, int]:
    """How many photographs are placed, and how many there are."""
    return found.rank[1], len(found.features)


def _placed(colmap: Any, database: Path, images: Path, folder: Path, count: int) -> Reconstruction:
    with colmap.Database.open(database) as opened:
        index = {image.image_id: image_index(image.name) for image in opened.read_all_images()}
        features = {index[k]: opened.num_keypoints_for_image(k) for k in index}
        matches = _verified_matches(colmap, opened, index)
    _log.info("%d pairs match; placing the cameras", len(matches))
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
    with colmap.Database.open(database) as opened:
        count = opened.num_images()
    _log.info("found features; matching %d pairs of photographs", count * (count - 1) // 2)
    colmap.match_exhaustive(
        database,
        matching_options=colmap.FeatureMatchingOptions(),
        verification_options=_geometry(colmap),
        device=colmap.Device.cpu,
    )


def _geometry(colmap: Any) -> Any:
    geometry = colmap.TwoViewGeometryOptions()
    geometry.ransac.random_seed = SEED
    geometry.ransac.max_error = MAX_ERROR
    return geometry


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
