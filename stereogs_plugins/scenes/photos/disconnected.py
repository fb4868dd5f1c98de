"""Photographs whose cameras were not found: what to train on, why the others are left out, what to do."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

from registry import SceneError
from registry.toolkit.networks import MODELS_VARIABLE

from .learned_matches import known_files
from .picture_files import listed, reason_lines
from .unposed_photos import MIN_PHOTOS

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from registry.toolkit.photos import ColmapModel

    from .found_cameras import FoundCameras
    from .no_depth import Doubt
    from .structure_from_motion import Reconstruction

FEW_FEATURES = 100
"""A photograph with fewer features is blurred, dark, or of a plain surface."""
ENOUGH_MATCHES = 30
"""Matches that COLMAP needs to add a photograph (`abs_pose_min_num_inliers`)."""
MANY_MATCHES = 200
"""Photographs with this many matches overlap; if they do not connect, there is another reason."""
_DOUBTS: dict[Doubt, str] = {
    "position": "they were taken from one position, so they contain no depth",
    "surface": "they show one flat surface, which does not determine the cameras",
    "pictures": "what surrounds the matches differs, as on opposite sides of a symmetric object",
}
_REMEDIES: dict[Doubt, str] = {
    "position": "take a step to the side between pictures, a tenth of the distance to the subject; "
    "do not turn on the spot",
    "surface": "include things in front of the surface or behind it, a quarter of each picture or more",
    "pictures": "take pictures between them, each with two thirds of the previous picture",
}
PAGE = "docs/photographs_do_not_connect.md"
_MAX_PAIRS = 6
_CONTRADICTING = "many matches with those that connect, but they contradict the cameras"
_POOR = "nearly no details: blurred, too dark, or of a plain surface"


class LargestGroup(NamedTuple):
    """The photographs that fit together.

    Args:
        model: their cameras and points.
        left_out: the reason for each photograph outside, by index.
        advice: what to photograph next; empty if no photograph is left out.
    """

    model: ColmapModel
    left_out: dict[int, str]
    advice: str


def largest_group(
    cameras: FoundCameras, names: Sequence[str], where: str, *, require_all: bool
) -> LargestGroup:
    """Return the largest group of photographs that fit together.

    Args:
        names: file names of the photographs, in the order of the indices.
        require_all: raise an error if the group does not contain every photograph.

    Raises:
        SceneError: fewer than three photographs fit together, or one does not although `require_all` is set;
            says which are left out and why, which pairs match, and what to photograph next.
    """
    found = cameras.reconstruction
    main = found.pieces[0].members if found.pieces else []
    left_out = _reasons(found, main, len(names))
    advice = _advice(found, main, left_out, names)
    placed = cameras.model is not None and len(main) >= min(MIN_PHOTOS, len(names))
    if placed and cameras.model is not None and not (left_out and require_all):
        return LargestGroup(cameras.model, left_out, advice)
    lines = [_summary(found, len(main), len(names))]
    if placed:
        lines[0] += ", and all are required"
        advice += (
            "\nor leave out --require-all-photos (`require_all_photos`) to train on the others"
        )
    if main:
        lines += reason_lines(left_out, names)
    lines.append(_strongest_pairs(found, left_out if placed else range(len(names)), names))
    raise SceneError("\n".join(lines), where=where, fix=f"{advice}\nmore: {PAGE}")


def _summary(found: Reconstruction, placed: int, count: int) -> str:
    if placed:
        return f"only {placed} of {count} photographs connect"
    most = max(found.matches.values(), default=0)
    if most < ENOUGH_MATCHES:
        return f"no camera could be placed: no two of the {count} photographs overlap enough"
    doubt = _usual_doubt(found)
    why = _DOUBTS[doubt] if doubt else "no depth follows from them"
    return f"no camera could be placed: the {count} photographs share up to {most:,} matches, but {why}"


def _usual_doubt(found: Reconstruction) -> Doubt | None:
    """Why most pairs with enough matches do not connect; None if there is no such reason."""
    overlapping = [pair for pair, matches in found.matches.items() if matches >= ENOUGH_MATCHES]
    doubts = [found.doubts.get(pair) for pair in overlapping]
    most, count = Counter(doubts).most_common(1)[0] if doubts else (None, 0)
    return most if 2 * count > len(doubts) else None


def _strongest_pairs(found: Reconstruction, of: Collection[int], names: Sequence[str]) -> str:
    """Return the pairs with most matches that contain one of these photographs."""
    pairs = sorted((-count, a, b) for (a, b), count in found.matches.items() if {a, b} & set(of))
    shown = (f"{names[a]} - {names[b]} {-count:,}" for count, a, b in pairs[:_MAX_PAIRS])
    return f"  tried {', '.join(found.tried)}; most matches: {', '.join(shown) or 'none'}"


def _reasons(found: Reconstruction, main: Collection[int], count: int) -> dict[int, str]:
    """Return why each photograph outside the main group does not connect to it."""
    outside = [k for k in range(count) if k not in main]
    best = {k: _best_link(found, k, main) for k in outside}
    links = {k: found.matches.get(pair, 0) for k, pair in best.items()}
    doubts = {k: found.doubts.get(pair) for k, pair in best.items() if links[k] >= ENOUGH_MATCHES}
    most = max((n for k, n in links.items() if n < MANY_MATCHES and not doubts.get(k)), default=0)
    too_few = f"at most {most} matches with those that connect, too few for a camera"
    if not most:
        too_few = "no matches with those that connect"
    reasons = {}
    for k in outside:
        doubt, contradicting = doubts.get(k), links[k] >= MANY_MATCHES
        reasons[k] = _CONTRADICTING if contradicting else too_few
        if doubt is not None:
            reasons[k] = _doubted(doubt)
        elif found.features[k] < FEW_FEATURES:
            reasons[k] = _POOR
    return reasons


def _doubted(doubt: Doubt) -> str:
    return f"matches with those that connect, but {_DOUBTS[doubt]}"


def _best_link(found: Reconstruction, photo: int, main: Collection[int]) -> tuple[int, int]:
    """Return the pair of a photograph and one of the main group that has most matches."""
    pairs = [_pair(photo, other) for other in main] or [(photo, photo)]
    return max(pairs, key=lambda pair: (found.matches.get(pair, 0), -pair[0], -pair[1]))


def _advice(
    found: Reconstruction, main: Collection[int], left_out: dict[int, str], names: Sequence[str]
) -> str:
    """Return what to photograph: a line for each kind of reason, and the networks if they are missing."""
    if not left_out:
        return ""
    lines, too_far = [], _usual_doubt(found) is None
    if not main:
        lines.append(_advice_without_cameras(found))
    else:
        poor = [k for k, reason in left_out.items() if reason == _POOR]
        contradicting = [k for k, reason in left_out.items() if reason == _CONTRADICTING]
        doubted = {_doubted(doubt): remedy for doubt, remedy in _REMEDIES.items()}
        other = (_POOR, _CONTRADICTING, *doubted)
        weak = [k for k, reason in left_out.items() if reason not in other]
        if weak:
            lines.append(_bridge(found, main, weak, names))
        too_far = bool(weak)
        lines += [remedy for reason, remedy in doubted.items() if reason in left_out.values()]
        if contradicting:
            lines.append(
                f"check if something moved in {listed(contradicting, names)}, or if the picture is cropped "
                "or zoomed; otherwise take another one a step to the side"
            )
        if poor:
            lines.append(f"take {listed(poor, names)} again, sharp and with enough light")
    if too_far and known_files() is None:
        lines.append(
            f"or set {MODELS_VARIABLE} to a folder with ALIKED and LightGlue, networks that match pictures "
            "farther apart (docs/prior_models.md#networks-that-were-run)"
        )
    return "\n".join(lines)


def _advice_without_cameras(found: Reconstruction) -> str:
    if max(found.matches.values(), default=0) < ENOUGH_MATCHES:
        return (
            "photograph the scene again with small steps to the side between pictures, so that two thirds of "
            "each picture are in the next"
        )
    doubt = _usual_doubt(found)
    if doubt is not None:
        return _REMEDIES[doubt]
    if len(found.features) < MIN_PHOTOS:
        return (
            "correct the focal length in EXIF if it is wrong, or add a third photograph to find it"
        )
    return (
        "take a step to the side between pictures, a tenth of the distance to the subject: pictures "
        "from one position, or of one flat surface, contain no depth"
    )


def _bridge(
    found: Reconstruction, main: Collection[int], weak: Sequence[int], names: Sequence[str]
) -> str:
    """Advice for the photographs with too few matches: where to take one that connects them.

    Between the two with most matches, or, without matches, that are nearest in the order of the names.
    """
    pairs = (
        (found.matches.get(_pair(k, other), 0), -abs(k - other), -k, -other)
        for k in weak
        for other in main
    )
    _, _, first, second = max(pairs)
    same = "if it shows the same scene" if len(weak) == 1 else "if they show the same scene"
    return (
        f"{same}, take pictures between {names[-second]} and {names[-first]}, each with two thirds of the "
        "previous one"
    )


def _pair(one: int, other: int) -> tuple[int, int]:
    return min(one, other), max(one, other)
