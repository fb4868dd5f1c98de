"""Whether the scores of runs mean the same; a refusal with the reason if not."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from registry import RunError
from registry.pipeline import load_protocol

from .comparison import FinishedRun, metric_names

NOT_ABOUT_SCORES = {"points", "near", "far", "image_memory_mb", "notes"}
"""What is recorded of a scene and may differ between runs whose scores can be compared."""


EXPLANATIONS = {"title", "notes"}
"""What a protocol says to people alone."""


def check_comparable(runs: Sequence[FinishedRun]) -> None:
    """Refuse runs whose scores do not mean the same.

    Raises:
        RunError: two runs follow different protocols, or follow none and show different scenes; the
            same scene was split or prepared in two ways; a metric was measured with other settings.
    """
    for other in runs[1:]:
        _check_protocol(runs[0], other)
    for index, run in enumerate(runs):
        for other in runs[:index]:
            _check_metrics(other, run)
            if run.scene == other.scene:
                _check_scene(other, run)


def comparable_groups(runs: Sequence[FinishedRun]) -> list[tuple[list[FinishedRun], str]]:
    """Runs whose scores mean the same, together; each with why it is not in a group before.

    A run joins the first group that it can be compared with. The reason names what keeps the group's
    first run out of the first group; it is empty for the first group.
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


def _check_protocol(first: FinishedRun, other: FinishedRun) -> None:
    if first.protocol != other.protocol:
        raise _refusal(
            first, other, f"one follows {_said(first.protocol)}, the other {_said(other.protocol)}"
        )
    if first.protocol is None:
        if first.scene != other.scene:
            raise _refusal(
                first,
                other,
                f"they show {first.scene!r} and {other.scene!r} and follow no protocol",
                fix="name a protocol in the pipeline, for example --set protocol=llff-3",
            )
        return
    key = _first_difference(_rules(first.results["protocol"]), _rules(other.results["protocol"]))
    if key is not None:
        what = f"the protocol {first.protocol!r} had another `{key}` when the other was run"
        raise _refusal(first, other, what, fix="train the older one again, as the protocol is now")


def check_present(run: FinishedRun) -> None:
    """Refuse a run whose protocol has changed since.

    Raises:
        RunError: the record of the protocol differs from the protocol as it is now; says in what.
    """
    record = run.results["protocol"]
    if record is None:
        return
    now = load_protocol(record["name"]).model_dump(mode="json")
    was, is_now = _rules({**record, "modified": {}}), _rules({**now, "modified": {}})
    key = _first_difference(was, is_now)
    if key is not None:
        raise RunError(
            f"the protocol {record['name']!r} has changed since this run: `{key}` was "
            f"{was.get(key)}, now it is {is_now.get(key)}",
            where=str(run.folder),
            fix="train it again, as the protocol is now",
        )


def _rules(record: Mapping[str, Any]) -> dict[str, Any]:
    """What of a protocol's record moves scores; nested settings by dotted names."""
    return dict(_dotted({k: v for k, v in record.items() if k not in EXPLANATIONS}))


def _dotted(tree: Mapping[str, Any], start: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _dotted(value, f"{start}{key}.")
        else:
            yield f"{start}{key}", value


def _said(protocol: str | None) -> str:
    return "no protocol" if protocol is None else f"the protocol {protocol!r}"


def _check_scene(first: FinishedRun, other: FinishedRun) -> None:
    one, two = (
        dict(_dotted({k: v for k, v in run.results["scene"].items() if k not in NOT_ABOUT_SCORES}))
        for run in (first, other)
    )
    key = _first_difference(one, two)
    if key is not None:
        raise _refusal(
            first,
            other,
            f"the scene {first.scene!r} differs in `{key}`: {one.get(key)} and {two.get(key)}",
        )


def _check_metrics(first: FinishedRun, other: FinishedRun) -> None:
    for name in metric_names([first]):
        if first.scores[name] is None or other.scores.get(name) is None:
            continue  # there are no two numbers to confuse
        one, two = (run.results["metrics"].get(name, {}) for run in (first, other))
        key = _first_difference(one, two)
        if key is not None:
            raise _refusal(
                first,
                other,
                f"{name} was measured with `{key}` {one.get(key)!r} and {two.get(key)!r}",
                fix="measure both alike; for example name one protocol in both pipelines",
            )


def _first_difference(one: Mapping[str, Any], two: Mapping[str, Any]) -> str | None:
    """The first key whose values differ by more than the last digits of a number."""
    for key in dict.fromkeys([*one, *two]):
        if key not in one or key not in two or not _alike(one[key], two[key]):
            return key
    return None


def _alike(one: Any, two: Any) -> bool:
    if isinstance(one, float) and isinstance(two, float):
        return math.isclose(one, two, rel_tol=1e-6)
    return bool(one == two)


def _refusal(first: FinishedRun, other: FinishedRun, what: str, fix: str = "") -> RunError:
    return RunError(
        f"these runs cannot be compared: {what}",
        where=f"{first.folder} and {other.folder}",
        fix=fix or "compare runs of one protocol and one preparation of the scene at a time",
    )
