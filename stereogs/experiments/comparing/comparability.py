"""Check whether the scores of runs are comparable."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from registry import RunError
from registry.pipeline.protocols import load_protocol

from .comparison import FinishedRun, dotted, metric_names

NOT_ABOUT_SCORES = {"points", "near", "far", "image_memory_mb", "notes"}
"""Properties of a scene that may differ between comparable runs."""
EXPLANATIONS = {"title", "notes"}
"""Texts of a protocol that do not affect scores."""


def check_comparable(runs: Sequence[FinishedRun]) -> None:
    """Check that scores are comparable.

    Raises:
        RunError: two runs have different protocols, or no protocol and different scenes; a scene was split or
            prepared in two ways, or has other test photographs or cameras; or a metric was measured with
            different settings.
    """
    for other in runs[1:]:
        _check_protocol(runs[0], other)
    for index, run in enumerate(runs):
        for other in runs[:index]:
            _check_metrics(other, run)
            if run.scene == other.scene:
                _check_scene(other, run)


def comparable_groups(runs: Sequence[FinishedRun]) -> list[tuple[list[FinishedRun], str]]:
    """Return groups of comparable runs, each with the reason for its separation from the first group.

    A run joins the first group that it is comparable with. The reason is empty for the first group.
    """
    groups: list[tuple[list[FinishedRun], str]] = []
    for run in runs:
        reason = ""
        for members, _ in groups:
            try:
                check_comparable([*members, run])
            except RunError as error:
                reason = reason or error.what
            else:
                members.append(run)
                break
        else:
            groups.append(([run], reason))
    return groups


def check_protocol_is_current(run: FinishedRun) -> None:
    """Check that the protocol has not changed since the run.

    Raises:
        RunError: it has; the error names the difference.
    """
    record = run.results["protocol"]
    if record is None:
        return
    now = load_protocol(record["name"]).model_dump(mode="json")
    before, after = _rules({**record, "modified": {}}), _rules({**now, "modified": {}})
    key = _first_difference(before, after)
    if key is not None:
        raise RunError(
            f"the protocol {record['name']!r} has changed since this run: `{key}` was "
            f"{before.get(key)} and is now {after.get(key)}",
            where=str(run.folder),
            fix="train it again with the current protocol",
        )


def _check_protocol(first: FinishedRun, other: FinishedRun) -> None:
    if first.protocol != other.protocol:
        one, two = (
            "no protocol" if run.protocol is None else f"the protocol {run.protocol!r}"
            for run in (first, other)
        )
        raise _not_comparable(first, other, f"one follows {one}, the other {two}")
    if first.protocol is None:
        if first.scene != other.scene:
            raise _not_comparable(
                first,
                other,
                f"they show {first.scene!r} and {other.scene!r} and follow no protocol",
                fix="set a protocol in the pipeline, for example --set protocol=llff-3",
            )
        return
    key = _first_difference(_rules(first.results["protocol"]), _rules(other.results["protocol"]))
    if key is not None:
        what = f"`{key}` of the protocol {first.protocol!r} changed between the runs"
        fix = "train the older run again with the current protocol"
        raise _not_comparable(first, other, what, fix)


def _check_scene(first: FinishedRun, other: FinishedRun) -> None:
    one, two = (
        dict(dotted({k: v for k, v in run.results["scene"].items() if k not in NOT_ABOUT_SCORES}))
        for run in (first, other)
    )
    key = _first_difference(one, two)
    if key is not None:
        what = f"the scene {first.scene!r} differs in `{key}`: {one.get(key)} and {two.get(key)}"
        raise _not_comparable(first, other, what)
    # Folders of one name may hold other photographs, and cameras may have been estimated again.
    for view in first.results["scene"]["test"]:
        for part in ("photograph", "camera"):
            one_digest, other_digest = (
                r.inputs.get(f"the {part} of {view}") for r in (first, other)
            )
            if one_digest and other_digest and one_digest != other_digest:
                what = f"the {part} of the test view {view} of {first.scene!r} differs"
                fix = "train both on the same photographs and cameras"
                raise _not_comparable(first, other, what, fix)


def _check_metrics(first: FinishedRun, other: FinishedRun) -> None:
    for name in metric_names([first]):
        if first.scores[name] is None or other.scores.get(name) is None:
            continue
        one, two = (run.results["metrics"].get(name, {}) for run in (first, other))
        key = _first_difference(one, two)
        if key is not None:
            raise _not_comparable(
                first,
                other,
                f"{name} was measured with `{key}` {one.get(key)!r} and {two.get(key)!r}",
                fix="use the same settings, for example by setting one protocol in both pipelines",
            )


def _rules(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of a protocol that affect scores, with dotted names."""
    return dict(dotted({k: v for k, v in record.items() if k not in EXPLANATIONS}))


def _first_difference(one: Mapping[str, Any], two: Mapping[str, Any]) -> str | None:
    """Return the first key whose values differ by more than rounding errors."""
    for key in dict.fromkeys([*one, *two]):
        if key not in one or key not in two or not _equal(one[key], two[key]):
            return key
    return None


def _equal(one: Any, two: Any) -> bool:
    if isinstance(one, float) and isinstance(two, float):
        return math.isclose(one, two, rel_tol=1e-6)
    return bool(one == two)


def _not_comparable(first: FinishedRun, other: FinishedRun, what: str, fix: str = "") -> RunError:
    return RunError(
        f"these runs are not comparable: {what}",
        where=f"{first.folder} and {other.folder}",
        fix=fix or "compare runs with one protocol and one preparation of the scene",
    )
