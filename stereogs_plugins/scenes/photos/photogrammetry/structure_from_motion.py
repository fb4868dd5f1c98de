"""Cameras from photographs by COLMAP's structure from motion on the CPU.

Matches of all pairs (matching.py), verified by two-view geometry with RANSAC, then mapping.py. If that does
not place every photograph, it is repeated with the next kind of matches. Focal lengths by EXIF are ignored if
the matches contradict them. Dense matches then refine the cameras (dense/refinement.py). The result is
deterministic: random choices are seeded, photographs are numbered before threads start, and mapping uses one
thread.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

from PIL import Image

from registry.toolkit.photos import read_mask, stored_form
from registry.toolkit.progress import in_parallel

from . import thresholds
from .colmap import (
    add_photos,
    create_database,
    image_index,
    image_name,
    mask_of,
    open_database,
    read_model,
    verified_pairs,
)
from .dense.check import DenseCheck
from .dense.refinement import refine
from .focal_lengths import are_unusual, contradict_exif, is_plausible
from .mapping import Piece, place_cameras, placed
from .matching import MATCHES, matchings, without_exif
from .network_start import estimated
from .two_view import Doubt, doubt_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from registry.priors import PosedDepth
    from registry.toolkit.photos import Decoder

    from ..unposed_photos import UnposedPhoto
    from .matching import Matching
    from .network_start import Estimate

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
    photos: Sequence[UnposedPhoto],
    decoder: Decoder,
    share_lens: bool,
    folder: Path,
    estimate: Estimate | None = None,
) -> Reconstruction:
    """Estimate cameras and points.

    Args:
        decoder: reads the photographs.
        share_lens: use one lens for all photographs of one camera, size and focal length.
        folder: empty folder for the working files and the models.
        estimate: prior whose cameras the matches refine; None searches for cameras with the matches alone.

    Raises:
        SceneError: a photograph is damaged.
    """
    images = folder / "images"
    images.mkdir()
    # pycolmap reads only files written here, because a truncated photograph would crash it.
    in_parallel(
        lambda k: _write_pictures(photos[k], decoder, images / image_name(k)),
        range(len(photos)),
        stage="reading",
    )

    @cache
    def start(focals: tuple[float | None, ...]) -> list[PosedDepth] | None:
        return None if estimate is None else estimated(estimate, images, focals)

    search = _Search(decoder, share_lens, images, folder, start)
    used = photos
    best: Reconstruction | None = None
    tried: list[str] = []
    for matching in matchings(images, folder, len(photos)):
        connected = best.pieces[0].members if best and best.pieces else []
        found = search.run(matching, used, connected)
        tried.append(matching.name)
        # Matches that place no photograph are not meaningful; they may be noise.
        if best is None or (found.pieces and found.rank > best.rank):
            best = found
        if used is photos and _may_have_wrong_exif(best, photos):
            again = without_exif(folder, matching)
            without = [replace(photo, focal=None) for photo in photos]
            other = search.run(again, without, connected)
            tried.append(again.name)
            if _refutes_exif(other, best, photos):
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
        refined = refine(read_model(pieces[0].folder), images, [photo.focal for photo in used])
        refined.model.write(pieces[0].folder)
        pieces[0] = pieces[0]._replace(
            focal_is_known=refined.focal_is_known, altered=refined.altered
        )
    return replace(best, pieces=pieces, tried=tuple(tried), ignores_exif=used is not photos)


def _write_pictures(photo: UnposedPhoto, decoder: Decoder, file: Path) -> None:
    """Write the upright photograph, and its mask if it has one: 255 for the pixels that count."""
    pixels = decoder.read(photo.path)
    Image.fromarray(pixels).save(file, compress_level=1)
    if photo.mask is not None:
        height, width = pixels.shape[:2]
        _, orientation = stored_form(photo.path)
        mask, _ = read_mask(photo.mask, (width, height), orientation=orientation)
        mask_of(file).parent.mkdir(exist_ok=True)
        Image.fromarray(mask).point(lambda value: 255 * (value == 255)).save(mask_of(file))


class _Search(NamedTuple):
    """Search for cameras in a folder, with one kind of matches at a time."""

    decoder: Decoder
    share_lens: bool
    images: Path
    folder: Path
    start: Callable[[tuple[float | None, ...]], list[PosedDepth] | None]

    def run(
        self, matching: Matching, photos: Sequence[UnposedPhoto], connected: Sequence[int]
    ) -> Reconstruction:
        focals = tuple(photo.focal for photo in photos)
        start = self.start(focals)
        workplace = self.folder / matching.name
        workplace.mkdir()
        database = workplace / MATCHES
        create_database(database)
        sizes = [self.decoder.size(*photo.size) for photo in photos]
        for group in _same_lens(photos, self.share_lens):
            focal, size = photos[group[0]].focal, sizes[group[0]]
            lens = None if focal is None else (focal * max(size), *size)
            add_photos(database, self.images, group, lens)
        matching.fill(database, connected)
        matches: dict[tuple[int, int], int] = {}
        doubts: dict[tuple[int, int], Doubt] = {}
        with open_database(database) as opened:
            index = {image.image_id: image_index(image.name) for image in opened.read_all_images()}
            features = {index[k]: opened.num_keypoints_for_image(k) for k in index}
            for pair in verified_pairs(opened):
                first, second = sorted(index[image] for image in pair.images)
                matches[first, second] = len(pair.matches)
                doubt = doubt_of(pair, sizes[first])
                if doubt is not None and sizes[first] == sizes[second]:
                    doubts[first, second] = doubt
        check = DenseCheck(self.images)
        pieces = place_cameras(
            database, self.images, workplace, focals, matching.trust, check.confirms, start
        )
        doubts |= dict.fromkeys(check.rejected, "pictures")
        return Reconstruction(
            pieces, matches, [features[k] for k in range(len(photos))], doubts=doubts
        )


def _same_lens(photos: Sequence[UnposedPhoto], share_lens: bool) -> list[list[int]]:
    """Indices of the photographs of each lens."""
    groups: dict[object, list[int]] = {}
    for index, photo in enumerate(photos):
        key = (photo.size, photo.camera, photo.focal) if share_lens else index
        groups.setdefault(key, []).append(index)
    return list(groups.values())


def _may_have_wrong_exif(found: Reconstruction, photos: Sequence[UnposedPhoto]) -> bool:
    """Whether EXIF has unusual focal lengths, or no free lens near them places all photographs."""
    focals = [photo.focal for photo in photos]
    if len(photos) < thresholds.MIN_PHOTOS or not any(focals):
        return False
    if placed(found.pieces) < len(photos) or found.pieces[0].fixed_lens or are_unusual(focals):
        return True
    return not is_plausible(read_model(found.pieces[0].folder), focals, thresholds.NEAR_EXIF)


def _refutes_exif(
    other: Reconstruction, found: Reconstruction, photos: Sequence[UnposedPhoto]
) -> bool:
    """Whether a reconstruction without EXIF places as many photographs, and EXIF fits worse or is unusual.

    Unusual focal lengths that fit as well are kept if a free lens near them placed the photographs.
    """
    if placed(other.pieces) < max(thresholds.MIN_PHOTOS, placed(found.pieces)):
        return False
    focals = [photo.focal for photo in photos]
    near_exif = bool(found.pieces) and not found.pieces[0].fixed_lens
    if are_unusual(focals) and not near_exif and not other.pieces[0].fixed_lens:
        return True
    return contradict_exif(read_model(other.pieces[0].folder), focals)
