"""What tells runs of one pipeline apart: the settings that are not the same in all of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from .comparison import FinishedRun

MOST = 3
"""Settings that a label names; the rest is counted."""
_ABSENT = object()
_NOT_SETTINGS = ("name", "scene.path")
_NO_PART = "observers"
"""The section that no number depends on."""


def labels(runs: Sequence[FinishedRun]) -> list[str]:
    """For each run its pipeline's name, with what differs among the runs of that name.

    Components of a list go by their name: `regularizers.stereo_depth.weight=2`. A setting that a run
    lacks is not told of it.
    """
    settings = [
        dict(_dotted({key: value for key, value in run.tree.items() if key != _NO_PART}))
        for run in runs
    ]
    found = []
    for run, own in zip(runs, settings, strict=True):
        same = [
            other for r, other in zip(runs, settings, strict=True) if r.pipeline == run.pipeline
        ]
        keys = dict.fromkeys(key for other in same for key in other if key not in _NOT_SETTINGS)
        apart = [
            f"{key}={_said(own[key])}"
            for key in keys
            if key in own and any(other.get(key, _ABSENT) != own[key] for other in same)
        ]
        more = [f"{len(apart) - MOST} more"] if len(apart) > MOST else []
        found.append(", ".join([run.pipeline, *apart[:MOST], *more]))
    return found


def _dotted(tree: Mapping[str, Any], start: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, list) and all(isinstance(item, Mapping) for item in value):
            value = {str(item.get("name", item.get("use"))): item for item in value}
        if isinstance(value, Mapping):
            yield from _dotted(value, f"{start}{key}.")
        else:
            yield f"{start}{key}", value


def _said(value: Any) -> str:
    return (
        "null" if value is None else str(value).lower() if isinstance(value, bool) else str(value)
    )
