"""Photographs whose cameras were not found: what to train on, why the others are left out, what to do."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Literal, NamedTuple

from registry import SceneError
from registry.toolkit.networks import MODELS_VARIABLE

from .photogrammetry.learned_matches import known_files
from .photogrammetry.thresholds import ENOUGH_MATCHES, FEW_FEATURES, MANY_MATCHES, MIN_PHOTOS
from .photogrammetry.two_view import Doubt
from .picture_files import listed, reason_lines

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from registry.toolkit.photos import ColmapModel

    from .found_cameras import FoundCameras
    from .photogrammetry.structure_from_motion import Reconstruction

Kind = Doubt | Literal["few", "contradicting", "poor"]
"""Why a photograph does not connect: doubtful, too few or contradicting matches, or poor features."""
_DOUBTS: dict[Doubt, str] = {
    "position": "they were taken from one position, so they contain no depth",
    "surface": "they show one flat surface, which does not determine the cameras",
    "pictures": "what surrounds the matches differs, as on opposite sides of a symmetric object",
}
_REASONS: dict[Kind, str] = {
    **{doubt: f"matches with those that connect, but {why}" for doubt, why in _DOUBTS.items()},
    "contradicting": "many matches with those that connect, but they contradict the cameras",
    "poor": "nearly no details: blurred, too dark, or of a plain surface",
}
_REMEDIES: dict[Kind, str] = {
    "position": "take a step to the side between pictures, a tenth of the distance to the subject; "
    "do not turn on the spot",
    "surface": "include things in front of the surface or behind it, a quarter of each picture or more",
    "pictures": "take pictures between them, each with two thirds of the previous picture",
    "contradicting": "check if something moved in {names}, or if the picture is cropped or zoomed; "
    "otherwise take another one a step to the side",
    "poor": "take {names} again, sharp and with enough light",
}
PAGE = "docs/photographs_do_not_connect.md"
_MAX_PAIRS = 6


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
    kinds, fewest = _kinds(found, main)
    left_out = {k: _REASONS.get(kind, fewest) for k, kind in kinds.items()}
    summary, advice = f"only {len(main)} of {len(names)} photographs connect", ""
    if not main:
        summary, advice = _without_cameras(found)
    elif kinds:
        advice = _advice(found, main, kinds, names)
    placed = len(main) >= min(MIN_PHOTOS, len(names))
    if placed and cameras.model is not None and not (kinds and require_all):
        return LargestGroup(cameras.model, left_out, advice)
    if placed:
        summary += ", and all are required"
        advice += (
            "\nor leave out --require-all-photos (`require_all_photos`) to train on the others"
        )
    lines = [summary, *(reason_lines(left_out, names) if main else ())]
    lines.append(_strongest_pairs(found, left_out if placed else range(len(names)), names))
    raise SceneError("\n".join(lines), where=where, fix=f"{advice}\nmore: {PAGE}")


def _without_cameras(found: Reconstruction) -> tuple[str, str]:
    """What is wrong if no two photographs connect, and advice."""
    count, most = len(found.features), max(found.matches.values(), default=0)
    if most < ENOUGH_MATCHES:
        why = f"no two of the {count} photographs overlap enough"
        advice = (
            "photograph the scene again with small steps to the side between pictures, so that two thirds of "
            "each picture are in the next"
        )
        return f"no camera could be placed: {why}", advice + _networks()
    overlapping = [pair for pair, matches in found.matches.items() if matches >= ENOUGH_MATCHES]
    (doubt, times), *_ = Counter(found.doubts.get(pair) for pair in overlapping).most_common(1)
    if doubt and 2 * times > len(overlapping):
        why, advice = _DOUBTS[doubt], _REMEDIES[doubt]
    else:
        why = "no depth follows from them"
        advice = (
            "take a step to the side between pictures, a tenth of the distance to the subject: pictures "
            "from one position, or of one flat surface, contain no depth"
        )
        if count < MIN_PHOTOS:
            advice = "correct the focal length in EXIF if it is wrong, or add a third photograph to find it"
        advice += _networks()
    what = f"the {count} photographs share up to {most:,} matches, but {why}"
    return f"no camera could be placed: {what}", advice


def _strongest_pairs(found: Reconstruction, of: Collection[int], names: Sequence[str]) -> str:
    """Return the pairs with most matches that contain one of these photographs."""
    pairs = sorted((-count, a, b) for (a, b), count in found.matches.items() if {a, b} & set(of))
    shown = (f"{names[a]} - {names[b]} {-count:,}" for count, a, b in pairs[:_MAX_PAIRS])
    return f"  tried {', '.join(found.tried)}; most matches: {', '.join(shown) or 'none'}"


def _kinds(found: Reconstruction, main: Collection[int]) -> tuple[dict[int, Kind], str]:
    """Return why each photograph outside the main group does not connect to it, and the reason of `few`."""
    kinds: dict[int, Kind] = {}
    most = 0
    for k in sorted({*range(len(found.features))}.difference(main)):
        pairs = [_pair(k, other) for other in main] or [(k, k)]
        best = max(pairs, key=lambda pair: (found.matches.get(pair, 0), -pair[0], -pair[1]))
        links = found.matches.get(best, 0)
        doubt = found.doubts.get(best) if links >= ENOUGH_MATCHES else None
        kinds[k] = doubt or ("few" if links < MANY_MATCHES else "contradicting")
        if doubt is None and links < MANY_MATCHES:
            most = max(most, links)
        if doubt is None and found.features[k] < FEW_FEATURES:
            kinds[k] = "poor"
    if not most:
        return kinds, "no matches with those that connect"
    return kinds, f"at most {most} matches with those that connect, too few for a camera"


def _advice(
    found: Reconstruction, main: Collection[int], kinds: dict[int, Kind], names: Sequence[str]
) -> str:
    """Return what to photograph: a line for each kind, and the networks if pictures are too far apart."""
    few = [k for k, kind in kinds.items() if kind == "few"]
    lines = [_bridge(found, main, few, names)] if few else []
    for kind, remedy in _REMEDIES.items():
        photos = [k for k, other in kinds.items() if other == kind]
        if photos:
            lines.append(remedy.format(names=listed(photos, names)))
    return "\n".join(lines) + (_networks() if few else "")


def _networks() -> str:
    """Return a line that suggests the networks if their files are missing."""
    if known_files() is not None:
        return ""
    return (
        f"\nor set {MODELS_VARIABLE} to a folder with ALIKED and LightGlue, networks that match pictures "
        "farther apart (`stereogs models get aliked-lightglue`)"
    )


def _bridge(
    found: Reconstruction, main: Collection[int], few: Sequence[int], names: Sequence[str]
) -> str:
    """Advice for the photographs with too few matches: where to take one that connects them.

    Between the two with most matches, or, without matches, that are nearest in the order of the names.
    """
    pairs = (
        (found.matches.get(_pair(k, other), 0), -abs(k - other), -k, -other)
        for k in few
        for other in main
    )
    _, _, first, second = max(pairs)
    same = "if it shows the same scene" if len(few) == 1 else "if they show the same scene"
    return (
        f"{same}, take pictures between {names[-second]} and {names[-first]}, each with two thirds of the "
        "previous one"
    )


def _pair(first: int, second: int) -> tuple[int, int]:
    return min(first, second), max(first, second)
