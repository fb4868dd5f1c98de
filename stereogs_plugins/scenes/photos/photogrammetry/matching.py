"""Kinds of matches, cheapest first: SIFT, SIFT with domain-size pooling, and SIFT with two networks."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from registry.toolkit.progress import progress

from . import thresholds
from .colmap import extract_sift, match_exhaustively, open_database, verify_matches
from .learned_matches import add_learned_matches, known_files
from .thresholds import Trust

if TYPE_CHECKING:
    from .colmap import Database

SECONDS = 0.5
"""Between two looks at the database."""
MATCHES = "matches.db"
"""Name of the database of a kind of matches, in a folder with the name of the kind."""


class Matching(NamedTuple):
    """A kind of matches.

    Args:
        name: for messages and folders.
        trust: matches that connect two photographs.
        fill: adds keypoints, matches and two-view geometries to a database with photographs; takes
            the indices of the photographs that were connected before.
    """

    name: str
    trust: Trust
    fill: Callable[[Path, Collection[int]], None]


def matchings(images: Path, folder: Path, count: int) -> list[Matching]:
    """Return the kinds of matches, cheapest first; those of networks only if their files exist.

    Args:
        images: folder of the photographs, named by index.
        folder: has the database of each kind that was tried before.
        count: number of photographs.
    """

    def sift(pooled: bool) -> Callable[[Path, Collection[int]], None]:
        def fill(database: Path, connected: Collection[int]) -> None:
            with rows_reported(database, _photos_with_keypoints, "features", count):
                extract_sift(database, images, pooled)
            with rows_reported(database, _matched_pairs, "matching", count * (count - 1) // 2):
                match_exhaustively(database)

        return fill

    found = [
        Matching("SIFT", thresholds.SIFT_TRUST, sift(False)),
        Matching("pooled SIFT", thresholds.SIFT_TRUST, sift(True)),
    ]
    files = known_files()
    if files is not None:

        def networks(database: Path, connected: Collection[int]) -> None:
            known = folder / found[0].name / MATCHES
            add_learned_matches(files, images, known, database, connected)

        found.append(Matching("SIFT with ALIKED and LightGlue", thresholds.LEARNED_TRUST, networks))
    return found


def _photos_with_keypoints(database: Database) -> int:
    return sum(database.exists_keypoints(image.image_id) for image in database.read_all_images())


def _matched_pairs(database: Database) -> int:
    images = sorted(image.image_id for image in database.read_all_images())
    return sum(database.exists_two_view_geometry(*pair) for pair in combinations(images, 2))


def without_exif(folder: Path, matching: Matching) -> Matching:
    """Return the keypoints and matches that were found before, to be verified again for other lenses."""

    def fill(database: Path, connected: Collection[int]) -> None:
        known = folder / matching.name / MATCHES
        with open_database(known) as old, open_database(database) as new:
            there = {image.name: image.image_id for image in old.read_all_images()}
            here = {image.name: image.image_id for image in new.read_all_images()}
            for name in here:
                new.write_keypoints(here[name], old.read_keypoints(there[name]))
            for first, second in combinations(here, 2):
                matches = old.read_matches(there[first], there[second])
                new.write_matches(here[first], here[second], matches)
        verify_matches(database)

    return Matching(f"{matching.name} without EXIF", matching.trust, fill)


@contextmanager
def rows_reported(
    database: Path, count: Callable[[Database], int], stage: str, total: int
) -> Iterator[None]:
    """Report a number of rows while the block fills a database: COLMAP has no callbacks.

    COLMAP's own SQLite reads it. With a second SQLite library in the process, such as Python's, the locks of
    one end when the other closes the file, and the process ends with SIGBUS now and then
    (https://sqlite.org/howtocorrupt.html, "Multiple copies of SQLite linked into the same application").

    Args:
        database: existing COLMAP database.
        count: returns the number of rows of an open database.
        stage, total: as for `registry.toolkit.progress`.
    """
    finished = threading.Event()

    def look() -> None:
        while not finished.wait(SECONDS):
            progress(stage, count(opened), total)

    progress(stage, 0, total)
    with open_database(database) as opened:
        thread = threading.Thread(target=look, name="rows of COLMAP", daemon=True)
        thread.start()
        try:
            yield
        finally:
            finished.set()
            thread.join()
    progress(stage, total, total)
