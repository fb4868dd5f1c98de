"""From matches to cameras: several mapping methods, until one places every photograph.

Incremental mapping starts from a pair with a wide triangulation angle. COLMAP requires 16 degrees, which
gives an exact start but excludes forward-facing captures; 2 degrees suffice for those. Global mapping needs
no first pair. The last attempt keeps the initial lens: with little perspective, matches fit any focal length.
Wrong models are contradicted by matches or by the pictures (support.py), or have implausible lenses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import count as numbers_from
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from registry.toolkit.progress import progress

from . import thresholds
from .colmap import index_of, map_globally, map_incrementally
from .focal_lengths import is_plausible
from .network_start import refined_start
from .support import drop_unsupported, is_contradicted

if TYPE_CHECKING:
    from registry.priors import PosedDepth

    from .colmap import Model
    from .support import Confirms
    from .thresholds import Trust


class Piece(NamedTuple):
    """A connected group of photographs.

    Args:
        folder: COLMAP model with photographs named by index.
        members: sorted indices of its photographs.
        focal_is_known: False if neither matches nor EXIF determine the focal length.
        fixed_lens: True if the initial lens was kept.
        altered: indices of photographs that seem to be zoomed or cropped.
    """

    folder: Path
    members: list[int]
    focal_is_known: bool = True
    fixed_lens: bool = False
    altered: Sequence[int] = ()


def place_cameras(
    database: Path,
    images: Path,
    folder: Path,
    focals: Sequence[float | None],
    trust: Trust,
    confirms: Confirms,
    start: Sequence[PosedDepth] | None = None,
) -> list[Piece]:
    """Return the pieces of the best attempt, best first; empty if no two photographs connect.

    Photographs and models that the matches or the pictures contradict are discarded, as are models with an
    implausible lens. Attempts run in order of cost; the one that places most photographs is returned.

    Args:
        database: keypoints, matches and two-view geometries.
        images: folder of the photographs, for the colours of points.
        folder: folder for the models.
        focals: focal length by EXIF of each photograph, in units of the longer side.
        trust: matches that suffice to connect photographs.
        confirms: decides about pairs with fewer.
        start: cameras of each photograph that are refined instead of a search for cameras.
    """
    best: list[Piece] = []
    count = len(focals)
    if count == 2:
        trust = thresholds.ALWAYS_CHECKED
    for attempt in _attempts(count) if start is None else _attempts_from(start):
        if placed(best) >= attempt.enough:
            break
        target = folder / attempt.name
        target.mkdir()
        found = [
            model
            for model in attempt.run(database, images, target)
            if is_plausible(model, focals)
            and drop_unsupported(database, model, trust, confirms)
            and not (attempt.fixed_lens and is_contradicted(database, model))
        ]
        best = max(best, _pieces(found, target, attempt.fixed_lens), key=placed)
    return best


def placed(pieces: list[Piece]) -> int:
    """Number of photographs in the best piece."""
    return len(pieces[0].members) if pieces else 0


class _Attempt(NamedTuple):
    """A mapping function.

    Args:
        run: takes the database and the folders of the photographs and of the models.
        enough: number of photographs placed before that makes the attempt unnecessary.
        fixed_lens: True if the initial lens is kept.
    """

    name: str
    run: Callable[[Path, Path, Path], list[Model]]
    enough: int
    fixed_lens: bool = False


def _attempts(total: int) -> list[_Attempt]:
    """Attempts for a number of photographs, cheapest first.

    Two photographs do not determine the focal length: the initial one is kept. With more, a fixed lens could
    place photographs that do not belong to it, so it is only for those that no free lens connects.
    """

    def incremental(degrees: float, fixed_lens: bool, *paths: Path) -> list[Model]:
        number = numbers_from(2)  # after the first pair
        progress("cameras", 0, total)
        return map_incrementally(
            *paths,
            degrees=degrees,
            fixed_lens=fixed_lens,
            on_image=lambda: progress("cameras", next(number), total),
        )

    fixed = [
        _Attempt(
            f"fixed_lens_{d:g}",
            partial(incremental, d, True),
            min(thresholds.MIN_PHOTOS, total),
            True,
        )
        for d in thresholds.FIRST_PAIR_DEGREES
    ]
    if total == 2:
        return fixed
    free = [
        _Attempt(f"incremental_{d:g}", partial(incremental, d, False), total)
        for d in thresholds.FIRST_PAIR_DEGREES
    ]
    return [*free, _Attempt("global", map_globally, total), fixed[-1]]


def _attempts_from(start: Sequence[PosedDepth]) -> list[_Attempt]:
    """Attempts that refine given cameras, with a free lens and with the given one."""

    def refined(fixed_lens: bool, database: Path, images: Path, folder: Path) -> list[Model]:
        return refined_start(start, database, images, folder, fixed_lens)

    total = len(start)
    fixed = _Attempt(
        "start_fixed_lens", partial(refined, True), min(thresholds.MIN_PHOTOS, total), True
    )
    return [fixed] if total == 2 else [_Attempt("start", partial(refined, False), total), fixed]


def _pieces(found: list[Model], folder: Path, fixed_lens: bool) -> list[Piece]:
    pieces = []
    for number, model in enumerate(found):
        path = folder / f"model_{number}"
        path.mkdir()
        model.write(path)
        members = sorted(index_of(model, k) for k in model.reg_image_ids())
        pieces.append(Piece(path, members, fixed_lens=fixed_lens))
    return sorted(pieces, key=lambda piece: -len(piece.members))
