"""Photographs whose cameras were not found: what to train on, why the others are left out, what to do."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from registry import SceneError

from .learned_matches import FOLDER_VARIABLE, known_files
from .mapping import connected
from .unposed_photos import MIN_PHOTOS

if TYPE_CHECKING:
    from collections.abc import Sequence

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
_PARTNERS = 3


def largest_group(
    cameras: FoundCameras, names: Sequence[str], where: str, *, require_all: bool
) -> tuple[ColmapModel, dict[int, str]]:
    """Return the model of the largest group of photographs that fit together.

    Args:
        names: file names of the photographs, in the order of the indices.
        require_all: raise an error if the group does not contain every photograph.

    Returns:
        the model, and advice for each photograph outside it, by index.

    Raises:
        SceneError: fewer than three photographs fit together, or one does not although `require_all` is set;
            lists which photographs connect, their matches, and what to photograph next.
    """
    found = cameras.reconstruction
    groups = _groups(found, len(names))
    main = groups[0]
    placed = cameras.model is not None and len(main) >= min(MIN_PHOTOS, len(names))
    if placed and cameras.model is not None and (len(groups) == 1 or not require_all):
        reasons = {k: _bridge(found, group, main, names) for group in groups[1:] for k in group}
        return cameras.model, reasons
    lines = [_summary(found, len(main), len(names))]
    if found.pieces:
        lines += [f"  group {n}: {_names(group, names)}" for n, group in enumerate(groups, start=1)]
    lines += _table(found, names)
    lines.append(f"  matched by {', by '.join(found.tried)}")
    fix = _advice(found, groups, names)
    if require_all and placed:
        fix += "\nor set `require_all_photos: false` to train on group 1"
    raise SceneError("\n".join(lines), where=where, fix=fix + _networks_advice())


def _networks_advice() -> str:
    if known_files() is not None:
        return ""
    return (
        f"\nor set {FOLDER_VARIABLE} to a folder with the networks ALIKED and LightGlue, which match "
        "pictures that are farther apart (docs/prior_models.md)"
    )


def _summary(found: Reconstruction, placed: int, count: int) -> str:
    if found.pieces:
        return (
            f"the cameras of {placed} of {count} photographs fit together; "
            "the others do not connect to them"
        )
    if _most_matches(found) < ENOUGH_MATCHES:
        return f"no camera could be placed: no two of the {count} photographs overlap enough"
    doubt = _usual_doubt(found)
    why = _DOUBTS[doubt] if doubt else "no depth follows from them"
    return (
        f"no camera could be placed: the {count} photographs share up to {_most_matches(found):,} "
        f"matches, but {why}"
    )


def _usual_doubt(found: Reconstruction) -> Doubt | None:
    """Why most pairs with enough matches do not connect; None if there is no such reason."""
    overlapping = [pair for pair, matches in found.matches.items() if matches >= ENOUGH_MATCHES]
    doubts = [found.doubts.get(pair) for pair in overlapping]
    most, count = Counter(doubts).most_common(1)[0] if doubts else (None, 0)
    return most if 2 * count > len(doubts) else None


def _most_matches(found: Reconstruction) -> int:
    return max(found.matches.values(), default=0)


def _groups(found: Reconstruction, count: int) -> list[list[int]]:
    """The pieces, largest first, then groups of the remaining photographs; each photograph once."""
    left = set(range(count))
    groups = []
    for piece in found.pieces:
        own = [k for k in piece.members if k in left]
        left -= set(own)
        if own:
            groups.append(own)
    # COLMAP searches less for an initial pair once it has a piece.
    rest = sorted(left)
    links = np.array(
        [[found.matches.get((a, b), 0) >= ENOUGH_MATCHES for b in rest] for a in rest], dtype=int
    )
    return groups + [[rest[k] for k in group] for group in (connected(links) if rest else ())]


def _names(group: Sequence[int], names: Sequence[str]) -> str:
    return ", ".join(names[k] for k in group)


def _partners(found: Reconstruction, photo: int) -> list[tuple[int, int]]:
    """`(matches, other photograph)`, best first."""
    pairs = ((n, a + b - photo) for (a, b), n in found.matches.items() if photo in (a, b))
    return sorted(pairs, key=lambda pair: (-pair[0], pair[1]))


def _table(found: Reconstruction, names: Sequence[str]) -> list[str]:
    """Each photograph with its best partners by verified matches."""
    width = max(map(len, names))
    lines = ["  matches that agree on one geometry:"]
    for k, name in enumerate(names):
        best = [f"{names[other]} {n}" for n, other in _partners(found, k)[:_PARTNERS]]
        lines.append(f"    {name:<{width}}  {', '.join(best) or 'none'}")
    return lines


def _advice(found: Reconstruction, groups: Sequence[list[int]], names: Sequence[str]) -> str:
    if found.pieces:
        # One line per reason: groups without any match share theirs.
        bridges = [_bridge(found, group, groups[0], names) for group in groups[1:]]
        return "\n".join(dict.fromkeys(bridges))
    if _most_matches(found) < ENOUGH_MATCHES:
        return (
            "photograph the scene again with small steps to the side between pictures, so that two thirds of "
            "each picture are in the next"
        )
    doubt = _usual_doubt(found)
    if doubt is not None:
        return _REMEDIES[doubt]
    return (
        "take a step to the side between pictures, a tenth of the distance to the subject: pictures "
        "from one position, or of one flat surface, contain no depth"
    )


def _bridge(
    found: Reconstruction, group: Sequence[int], main: Sequence[int], names: Sequence[str]
) -> str:
    """Advice for connecting a group to the main one."""
    poor = [k for k in group if found.features[k] < FEW_FEATURES]
    if poor:
        return (
            f"take {_names(poor, names)} again: {found.features[poor[0]]} details were found, so it is "
            "blurred, too dark, or of a plain surface"
        )
    links = ((found.matches.get((min(a, b), max(a, b)), 0), -a, -b) for a in group for b in main)
    matches, a, b = max(links)
    doubt = found.doubts.get((min(-a, -b), max(-a, -b)))
    if matches >= ENOUGH_MATCHES and doubt is not None:
        return (
            f"{names[-a]} shares {matches:,} matches with {names[-b]}, but {_DOUBTS[doubt]}: "
            f"{_REMEDIES[doubt]}"
        )
    if matches >= MANY_MATCHES:
        return (
            f"{names[-a]} shares {matches:,} matches with {names[-b]} but does not fit: check if something "
            "moved, or if the picture is cropped or zoomed; otherwise take another a step to the side"
        )
    if matches:
        return (
            f"take a picture between {names[-a]} and {names[-b]}, which share only "
            f"{matches} matches"
        )
    apart = [k for k in range(len(names)) if not _matches_with(found, k, main)]
    return (
        f"{_names(apart, names)} {'has' if len(apart) == 1 else 'have'} no matches with the largest group: "
        "take pictures between them, each with two thirds of the previous picture"
    )


def _matches_with(found: Reconstruction, photo: int, main: Sequence[int]) -> bool:
    """Whether a photograph belongs to the main group or matches one of it."""
    return photo in main or any(photo in pair and (set(pair) & set(main)) for pair in found.matches)
