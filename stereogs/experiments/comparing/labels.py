"""Short labels of runs: what differs between them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from .comparison import FinishedRun, dotted

SEED = "training.seed"
MAX_PARTS = 3
"""Largest number of differences in a label."""
_LENGTH = "training.iterations"
_WORDS = {
    _LENGTH: "{} iterations",
    SEED: "seed {}",
    "scene.train_views": "{} training views",
}
_SCALED = ("start", "stop", "every", "phase", "sh_every", "position_steps")
"""Settings that scale with the number of iterations."""
_AFTER_TRAINING = ("metrics.", "exporters.", "reports.")
_ABSENT = object()
_Values = Mapping[str, Any]


def labels(runs: Sequence[FinishedRun], *, seeds: bool = True) -> list[str]:
    """Return for each run what distinguishes it from the others of its pipeline.

    `seeds` says whether different seeds do.

    A component that differs is named without its settings. Schedules that follow from the number of
    iterations are left out, and so is the name of the pipeline if all have the same and something differs.
    """
    settings = [_settings(run) for run in runs]
    if not seeds:
        settings = [{key: v for key, v in own.items() if key != SEED} for own in settings]
    found = []
    for run, own in zip(runs, settings, strict=True):
        same = [
            other for r, other in zip(runs, settings, strict=True) if r.pipeline == run.pipeline
        ]
        parts = list(_differences(own, same))
        rest = len(parts) - MAX_PARTS
        more = [f"{rest} more"] if rest > 0 else []
        found.append([*parts[:MAX_PARTS], *more])
    one_name = len({run.pipeline for run in runs}) == 1 and all(found)
    return [
        ", ".join(parts if one_name else [run.pipeline, *parts])
        for run, parts in zip(runs, found, strict=True)
    ]


def _settings(run: FinishedRun) -> _Values:
    """Return the settings that results depend on, dotted; components of lists are identified by name."""
    tree = {k: v for k, v in run.tree.items() if k not in ("name", "observers")}
    return {
        key: value
        for key, value in dotted(_named_lists(tree))
        if key != "scene.path" and not (value is None and "." not in key)
    }


def _differences(own: _Values, same: Sequence[_Values]) -> Iterator[str]:
    """Yield the differences from the other runs of the pipeline, in the order of the pipeline."""
    keys = list(dict.fromkeys(key for other in same for key in other))
    replaced: set[str] = set()
    for key in keys:
        component, _, setting = key.rpartition(".")
        values = [other.get(key, _ABSENT) for other in same]
        if component in replaced or all(value == values[0] for value in values):
            continue
        if setting == "use":
            replaced.add(component)
            if not component.startswith(_AFTER_TRAINING):
                yield _component(component, own.get(key))
        elif key in own and not _follows_length(key, same):
            text = _text(own[key])
            yield _WORDS[key].format(text) if key in _WORDS else f"{key}={text}"


def _component(path: str, use: str | None) -> str:
    name = path.split(".")[-1]
    if use is None:
        return f"no {name}"
    return name if name == use else f"{name} {use}"


def _follows_length(key: str, same: Sequence[_Values]) -> bool:
    """Return whether a setting is the same share of the iterations in all runs, up to rounding."""
    component, _, setting = key.rpartition(".")
    if setting not in _SCALED:
        return False
    due = [other for other in same if not _never_due(component, other)]
    pairs = {(other[key], other[_LENGTH]) for other in due if key in other}
    if not all(isinstance(value, int) for value, _ in pairs):
        return False
    if len({length for _, length in pairs}) < len(pairs):
        return False  # runs of one length differ
    if len({value for value, _ in pairs}) <= 1:
        return len(due) < len(same)  # it differs only where the component is never due
    least, most = (max((v - 1) / n for v, n in pairs), min((v + 1) / n for v, n in pairs))
    return bool(least <= most)


def _never_due(component: str, values: _Values) -> bool:
    """Return whether a run is so short that the schedule of a component is empty."""
    start = values.get(f"{component}.start")
    return isinstance(start, int) and start > int(values[_LENGTH])


def _named_lists(value: Any) -> Any:
    """Replace lists of components by mappings from their names."""
    if isinstance(value, list) and all(isinstance(item, Mapping) for item in value):
        value = {str(item.get("name", item.get("use"))): item for item in value}
    if isinstance(value, Mapping):
        return {key: _named_lists(child) for key, child in value.items()}
    return value


def _text(value: Any) -> str:
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else str(value)
