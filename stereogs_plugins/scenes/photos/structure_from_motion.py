"""Cameras from photographs by COLMAP's structure from motion on the CPU.

SIFT (Lowe 2004), exhaustive matching, two-view geometry by RANSAC, then mapping.py. If that does not place
every photograph, it is repeated with domain-size pooling (Dong and Soatto 2015), which tolerates wider
baselines and takes several times as long, then with additional matches of two networks (learned_matches.py)
if their files exist. Focal lengths by EXIF are ignored if the matches contradict them. The result is
deterministic: random choices are seeded, photographs are numbered before threads start, and mapping uses one
thread. Dense matches then refine the cameras (dense/refinement.py).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

from PIL import Image

from registry.toolkit.photos import Decoder, import_pycolmap
from registry.toolkit.progress import in_parallel

from .dense.check import DenseCheck
from .dense.refinement import contradicts_exif, refine
from .learned_matches import add_learned_matches, known_files
from .mapping import (
    FOCAL_RANGE,
    LEARNED_TRUST,
    MAX_ERROR,
    SEED,
    SIFT_TRUST,
    Piece,
    Trust,
    is_plausible,
    place_cameras,
    placed,
)
from .no_depth import Doubt, doubt_of
from .reported import rows_reported
from .unposed_photos import MIN_PHOTOS, image_index, image_name

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from .unposed_photos import UnposedPhoto

MATCHES = "matches.db"
NEAR_EXIF = 1.5
"""Ratio to the focal length by EXIF, or its inverse, from which one of the two is probably wrong."""
_log = logging.getLogger("stereogs.photos")


@dataclass(frozen=True)
class Reconstruction:
    """Result of structure from motion.

    Args:
        pieces: connected groups of photographs, best first.
        matches: number of verified matches by pair of indices, first < second.
        features: number of features of each photograph.
        tried: names of the kinds of matches used, for messages.
        doubts: why the matches of pairs of indices do not connect them.
        ignores_exif: True if the matches contradict the focal lengths by EXIF, which are then not used.
    """

    pieces: list[Piece]
    matches: dict[tuple[int, int], int]
    features: list[int]
    tried: tuple[str, ...] = ("SIFT",)
    doubts: dict[tuple[int, int], Doubt] = field(default_factory=dict)
    ignores_exif: bool = False

    @property
    def rank(self) -> tuple[int, int]:
        """Order of results: number of photographs placed, number of matches."""
        return placed(self.pieces), sum(self.matches.values())


def reconstruct(
    photos: Sequence[UnposedPhoto], decoder: Decoder, share_lens: bool, folder: Path
) -> Reconstruction:
    """Estimate cameras and points.

    Args:
        decoder: reads the photographs.
        share_lens: use one lens for all photographs of one camera, size and focal length.
        folder: empty folder for the working files and the models.

    Raises:
        SceneError: a photograph is damaged.
    """
    # COLMAP logs a missing model as an error; disconnected.py explains it instead.
    colmap = import_pycolmap(least_severity=3)
    images = folder / "images"
    images.mkdir()
    # pycolmap reads only files written here, because a truncated photograph would crash it.
    in_parallel(
        lambda k: Image.fromarray(decoder.read(photos[k].path)).save(
            images / image_name(k), compress_level=1
        ),
        range(len(photos)),
        stage="reading",
    )
    search = _Search(colmap, decoder, share_lens, images, folder)
    used = photos
    best: Reconstruction | None = None
    tried: list[str] = []
    for way in _ways(colmap, images, folder, len(photos)):
        found = search.run(way, used)
        tried.append(way.name)
        # Matches that place no photograph are not meaningful; they may be noise.
        if best is None or (found.pieces and found.rank > best.rank):
            best = found
        if used is photos and _may_have_wrong_exif(colmap, best, photos):
            again = _same_matches(colmap, folder, way)
            without = [replace(photo, focal=None) for photo in photos]
            other = search.run(again, without)
            tried.append(again.name)
            if _refutes_exif(colmap, other, best, photos):
                used, best = without, other
        if placed(best.pieces) == len(photos):
            break
        _log.info(
            "%s: the cameras of %d of %d photographs fit together",
            *(tried[-1], placed(best.pieces), len(photos)),
        )
    assert best is not None
    pieces = list(best.pieces)
    if pieces:
        pieces[0] = _refined(colmap, pieces[0], images, [photo.focal for photo in used])
    return replace(best, pieces=pieces, tried=tuple(tried), ignores_exif=used is not photos)


class _Way(NamedTuple):
    """A kind of matches: its name, trust in them, and a function that fills a database."""

    name: str
    trust: Trust
    fill: Callable[[Path], None]


@dataclass(frozen=True)
class _Search:
    """Search for cameras in a folder, with one kind of matches at a time."""

    colmap: Any
    decoder: Decoder
    share_lens: bool
    images: Path
    folder: Path

    def run(self, way: _Way, photos: Sequence[UnposedPhoto]) -> Reconstruction:
        workplace = self.folder / way.name
        workplace.mkdir()
        database = workplace / MATCHES
        self.colmap.set_random_seed(SEED)
        self.colmap.Database.open(database).close()  # import_images wants it to exist
        for group in _lenses(photos, self.share_lens):
            _import(self.colmap, database, self.images, group, photos[group[0]], self.decoder)
        way.fill(database)
        focals = [photo.focal for photo in photos]
        return _placed(self.colmap, database, self.images, workplace, focals, way.trust)


def _may_have_wrong_exif(
    colmap: Any, found: Reconstruction, photos: Sequence[UnposedPhoto]
) -> bool:
    """Whether EXIF has unusual focal lengths, or no free lens near them places all photographs."""
    focals = [photo.focal for photo in photos]
    if len(photos) < MIN_PHOTOS or not any(focals):
        return False
    if placed(found.pieces) < len(photos) or found.pieces[0].fixed_lens or _unusual(focals):
        return True
    return not is_plausible(colmap.Reconstruction(found.pieces[0].folder), focals, NEAR_EXIF)


def _refutes_exif(
    colmap: Any, other: Reconstruction, found: Reconstruction, photos: Sequence[UnposedPhoto]
) -> bool:
    """Whether a reconstruction without EXIF places as many photographs, and EXIF fits worse or is unusual.

    Unusual focal lengths that fit as well are kept if a free lens near them placed the photographs.
    """
    if placed(other.pieces) < max(MIN_PHOTOS, placed(found.pieces)):
        return False
    focals = [photo.focal for photo in photos]
    near_exif = bool(found.pieces) and not found.pieces[0].fixed_lens
    if _unusual(focals) and not near_exif and not other.pieces[0].fixed_lens:
        return True
    return contradicts_exif(colmap, colmap.Reconstruction(other.pieces[0].folder), focals)


def _unusual(focals: Sequence[float | None]) -> bool:
    shortest, longest = FOCAL_RANGE
    return any(focal is not None and not shortest < focal < longest for focal in focals)


def _ways(colmap: Any, images: Path, folder: Path, count: int) -> list[_Way]:
    """Kinds of matches, cheapest first."""

    def by_sift(pooled: bool) -> Callable[[Path], None]:
        def fill(database: Path) -> None:
            _extract(colmap, database, images, pooled, count)
            _match(colmap, database, count)

        return fill

    ways = [
        _Way("SIFT", SIFT_TRUST, by_sift(False)),
        _Way("pooled SIFT", SIFT_TRUST, by_sift(True)),
    ]
    files = known_files()
    if files is not None:

        def by_networks(database: Path) -> None:
            add_learned_matches(colmap, files, images, folder / ways[0].name / MATCHES, database)
            colmap.geometric_verification(database, two_view_geometry_options=_geometry(colmap))

        ways.append(_Way("SIFT with ALIKED and LightGlue", LEARNED_TRUST, by_networks))
    return ways


def _same_matches(colmap: Any, folder: Path, way: _Way) -> _Way:
    """Keypoints and matches that were found before, verified again for other lenses."""

    def fill(database: Path) -> None:
        known = folder / way.name / MATCHES
        with colmap.Database.open(known) as old, colmap.Database.open(database) as new:
            there = {image.name: image.image_id for image in old.read_all_images()}
            here = {image.name: image.image_id for image in new.read_all_images()}
            for name in here:
                new.write_keypoints(here[name], old.read_keypoints(there[name]))
            for first, second in combinations(here, 2):
                matches = old.read_matches(there[first], there[second])
                new.write_matches(here[first], here[second], matches)
        colmap.geometric_verification(database, two_view_geometry_options=_geometry(colmap))

    return _Way(f"{way.name} without EXIF", way.trust, fill)


def _placed(
    colmap: Any,
    database: Path,
    images: Path,
    folder: Path,
    focals: Sequence[float | None],
    trust: Trust,
) -> Reconstruction:
    with colmap.Database.open(database) as opened:
        index = {image.image_id: image_index(image.name) for image in opened.read_all_images()}
        features = {index[k]: opened.num_keypoints_for_image(k) for k in index}
        matches, doubts = _verified_matches(colmap, opened, index)
    check = DenseCheck(images)
    pieces = place_cameras(colmap, database, images, folder, focals, trust, check.confirms)
    doubts |= dict.fromkeys(check.rejected, "pictures")
    return Reconstruction(pieces, matches, [features[k] for k in range(len(focals))], doubts=doubts)


def _refined(colmap: Any, piece: Piece, images: Path, focals: Sequence[float | None]) -> Piece:
    model = colmap.Reconstruction(piece.folder)
    refined = refine(colmap, model, images, focals)
    refined.model.write(piece.folder)
    return piece._replace(focal_is_known=refined.focal_is_known, altered=refined.altered)


def _lenses(photos: Sequence[UnposedPhoto], share_lens: bool) -> list[list[int]]:
    """Indices of the photographs of each lens."""
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
    """Add the photographs of one lens, of which `photo` is one, in a fixed order."""
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


def _extract(colmap: Any, database: Path, images: Path, pooled: bool, count: int) -> None:
    options = colmap.FeatureExtractionOptions()
    options.sift.domain_size_pooling = pooled

    def done(opened: Any) -> int:
        return sum(opened.exists_keypoints(image.image_id) for image in opened.read_all_images())

    with rows_reported(colmap, database, done, "features", count):
        colmap.extract_features(
            database, images, extraction_options=options, device=colmap.Device.cpu
        )


def _match(colmap: Any, database: Path, count: int) -> None:
    def done(opened: Any) -> int:
        images = sorted(image.image_id for image in opened.read_all_images())
        return sum(opened.exists_two_view_geometry(*pair) for pair in combinations(images, 2))

    with rows_reported(colmap, database, done, "matching", count * (count - 1) // 2):
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
) -> tuple[dict[tuple[int, int], int], dict[tuple[int, int], Doubt]]:
    """Number of verified matches of each pair, and why pairs contain no depth."""
    cameras = {camera.camera_id: camera for camera in database.read_all_cameras()}
    sizes = {}
    for image in database.read_all_images():
        camera = cameras[image.camera_id]
        sizes[index[image.image_id]] = (camera.width, camera.height)
    pairs, geometries = database.read_two_view_geometries()
    matches: dict[tuple[int, int], int] = {}
    doubts: dict[tuple[int, int], Doubt] = {}
    for pair, geometry in zip(pairs, geometries, strict=True):
        first, second = sorted(index[image] for image in colmap.pair_id_to_image_pair(pair))
        if len(geometry.inlier_matches):
            matches[first, second] = len(geometry.inlier_matches)
            doubt = doubt_of(colmap, geometry, sizes[first])
            if doubt is not None and sizes[first] == sizes[second]:
                doubts[first, second] = doubt
    return matches, doubts
