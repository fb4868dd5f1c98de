"""What to tell when the cameras of some photographs could not be found."""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry import SceneError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from registry.toolkit.photos import ColmapModel

    from .found_cameras import FoundCameras
    from .structure_from_motion import Reconstruction

FEW_FEATURES = 100
"""A photograph with fewer is blurred, dark, or of a plain surface."""
ENOUGH_MATCHES = 30
"""What COLMAP needs to add a photograph to others (`abs_pose_min_num_inliers`)."""
MANY_MATCHES = 200
"""Photographs that share so many overlap; if they do not fit together, the reason is another."""
_PARTNERS = 3


def require_one_piece(cameras: FoundCameras, names: Sequence[str], where: str) -> ColmapModel:
    """The model of a reconstruction that is one piece with every photograph.

    Args:
        names: the photographs' file names, in the order of the indices.

    Raises:
        SceneError: says which photographs connect, how well, and what to photograph next.
    """
    found = cameras.reconstruction
    groups = _groups(found, len(names))
    if len(groups) == 1 and cameras.model is not None:
        return cameras.model
    what = _summary(found, len(groups[0]), len(names))
    lines = [what]
    if found.pieces:
        lines += [f"  group {n}: {_names(group, names)}" for n, group in enumerate(groups, start=1)]
    lines += _table(found, names)
    lines.append(f"  matched by {', by '.join(found.tried)}")
    raise SceneError("\n".join(lines), where=where, fix=_advice(found, groups, names))


def _summary(found: Reconstruction, placed: int, count: int) -> str:
    if found.pieces:
        return (
            f"the cameras of {placed} of {count} photographs fit together; "
            "the others do not connect to them"
        )
    if _most_matches(found) < ENOUGH_MATCHES:
        return f"no camera could be placed: no two of the {count} photographs overlap enough"
    return (
        f"no camera could be placed: the {count} photographs share up to {_most_matches(found):,} "
        "matches, but no depth follows from them"
    )


def _most_matches(found: Reconstruction) -> int:
    return max(found.matches.values(), default=0)


def _groups(found: Reconstruction, count: int) -> list[list[int]]:
    """The pieces, the largest first, then what is left by matches; each photograph once."""
    left = set(range(count))
    groups = []
    for piece in found.pieces:
        own = [k for k in piece.members if k in left]
        left -= set(own)
        if own:
            groups.append(own)
    # COLMAP looks for its first two photographs less patiently once there is a piece.
    return groups + _connected(sorted(left), found.matches)


def _connected(photos: list[int], matches: dict[tuple[int, int], int]) -> list[list[int]]:
    """Photographs grouped by chains of pairs that share enough matches."""
    label = {k: k for k in photos}
    for (first, second), count in matches.items():
        if count >= ENOUGH_MATCHES and first in label and second in label:
            old, new = label[second], label[first]
            label = {k: new if value == old else value for k, value in label.items()}
    groups: dict[int, list[int]] = {}
    for k in photos:
        groups.setdefault(label[k], []).append(k)
    return list(groups.values())


def _names(group: Sequence[int], names: Sequence[str]) -> str:
    return ", ".join(names[k] for k in group)


def _partners(found: Reconstruction, photo: int) -> list[tuple[int, int]]:
    """`(matches, other photograph)`, the best first."""
    pairs = ((n, a + b - photo) for (a, b), n in found.matches.items() if photo in (a, b))
    return sorted(pairs, key=lambda pair: (-pair[0], pair[1]))


def _table(found: Reconstruction, names: Sequence[str]) -> list[str]:
    """Each photograph with those that it shares most verified matches with."""
    width = max(map(len, names))
    lines = ["  matches that agree on one geometry:"]
    for k, name in enumerate(names):
        best = [f"{names[other]} {n}" for n, other in _partners(found, k)[:_PARTNERS]]
        lines.append(f"    {name:<{width}}  {', '.join(best) or 'none'}")
    return lines


def _advice(found: Reconstruction, groups: Sequence[list[int]], names: Sequence[str]) -> str:
    if found.pieces:
        advice = [_bridge(found, group, groups[0], names) for group in groups[1:]]
        return "\n".join([*advice, "or take those photographs out of the folder"])
    if _most_matches(found) < ENOUGH_MATCHES:
        return (
            "photograph the scene again from places close together: two thirds of each picture "
            "should be in the next, which is taken a step to the side"
        )
    return (
        "take a step to the side between pictures, a tenth of the distance to the subject: pictures "
        "from one spot, or of one flat thing, say nothing about depth"
    )


def _bridge(
    found: Reconstruction, group: Sequence[int], main: Sequence[int], names: Sequence[str]
) -> str:
    """What would connect a group to the main one."""
    poor = [k for k in group if found.features[k] < FEW_FEATURES]
    if poor:
        return (
            f"take {_names(poor, names)} again: {found.features[poor[0]]} details were found in it, "
            "so it is blurred, too dark, or shows a plain surface"
        )
    links = ((found.matches.get((min(a, b), max(a, b)), 0), -a, -b) for a in group for b in main)
    matches, a, b = max(links)
    if matches >= MANY_MATCHES:
        return (
            f"{names[-a]} shares {matches:,} matches with {names[-b]} and yet does not fit in beside "
            "it: was something moved, or the picture cropped or zoomed? If not, take another from a "
            "place to the side"
        )
    if matches:
        return (
            f"take a picture between {names[-a]} and {names[-b]}, which share only "
            f"{matches} matches"
        )
    return (
        f"no overlap between {_names(group, names)} and the rest: take pictures between them, "
        "each showing two thirds of what the one before shows"
    )
