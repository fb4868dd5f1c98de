"""results.json as it is read back: what it must say, and whether it agrees with itself.

A run folder may come from anywhere, by mail or out of an archive. What is set side by side with other
runs, put into a table or on a page, is held to this first.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..errors import RunError

LARGEST = 12_000_000
"""Bytes; the scores of 10,000 views take 2 MB."""
TOLERANCE = 1e-6
"""Relative; a mean and that of the views differ by roundings alone."""

Count = Annotated[int, Field(ge=0)]
Amount = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1, max_length=500)]
Score = Number | None
"""None is infinite, or not available; JSON has no word for either."""
Scores = dict[Name, Score]


class _Record(BaseModel):
    """A part of the file. Versions differ in what they write, so anything more may stand there."""

    model_config = ConfigDict(extra="allow")


class _Protocol(_Record):
    name: Name
    modified: dict[str, Any]


class _Scene(_Record):
    name: Name
    train: tuple[Name, ...] = ()
    test: tuple[Name, ...] = ()
    width: Count = 0
    height: Count = 0
    extent: Amount = 0.0
    near: Amount = 0.0
    far: Amount = 0.0
    points: Count = 0
    image_memory_mb: Amount = 0.0
    facts: dict[Name, Any] = Field(default_factory=dict)
    notes: dict[Name, Any] = Field(default_factory=dict)


class _Views(_Record):
    train: dict[Name, Scores] = Field(default_factory=dict)
    test: dict[Name, Scores] = Field(default_factory=dict)


class Results(_Record):
    """The file's fields by type and range; which of them are needed is for the reader to say."""

    pipeline: Name = "unnamed"
    protocol: _Protocol | None = None
    scene: _Scene | None = None
    metrics: dict[Name, dict[str, Any]] = Field(default_factory=dict)
    device: dict[Name, str] = Field(default_factory=dict)
    seed: int = 0
    iterations: Count = 0
    gaussians: Count = 0
    hash: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] = "0" * 64
    initialization: dict[Name, Any] = Field(default_factory=dict)
    seconds: Amount = 0.0
    seconds_total: Amount = 0.0
    stages: dict[Name, Amount] = Field(default_factory=dict)
    iterations_per_second: Amount = 0.0
    peak_memory_mb: Amount | None = None
    exports: tuple[Name, ...] = ()
    reports: tuple[Name, ...] = ()
    changed_inputs: tuple[Name, ...] = ()
    train: Scores = Field(default_factory=dict)
    test: Scores = Field(default_factory=dict)
    views: _Views = _Views()
    unavailable: dict[Name, str] = Field(default_factory=dict)


def read_results(path: Path) -> dict[str, Any]:
    """The content of a results.json, as it stands there.

    Args:
        path: of the file.

    Raises:
        RunError: it is missing, larger than 12 MB, no JSON object, says a thing twice, has a field of a
            wrong type or range, or a text that would move a terminal's cursor; a mean is not that of
            the views; or the scored views are not those of the scene.
    """
    try:
        if not path.is_file():
            raise _refused("there is no such file", path)
        size = path.stat().st_size
        if size > LARGEST:
            raise _refused(f"it has {size:,} bytes, more than {LARGEST:,}", path)
        content: Any = json.loads(path.read_bytes(), object_pairs_hook=_once)
        # Through JSON again: only so do pydantic's strict types take a list as a tuple.
        results = Results.model_validate_json(json.dumps(content), strict=True)
    except OSError as error:
        raise _refused(str(error.strerror or error), path) from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "all of it"
        raise _refused(f"{place}: {first['msg']}", path) from error
    except (ValueError, RecursionError) as error:
        raise _refused(f"it is no JSON: {error}", path) from error
    problem = next(_problems(results, content), None)
    if problem is not None:
        raise _refused(problem, path)
    return dict(content)


def _refused(what: str, path: Path) -> RunError:
    return RunError(
        f"{path.name} cannot be believed: {what}",
        where=str(path),
        fix=f"remove it, and score the run anew: stereogs eval {path.parent}",
    )


def _once(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """An object whose keys are different; of two equal ones, readers would take one or the other."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key is written twice")
    return found


def _problems(results: Results, content: Any) -> Iterator[str]:
    for text in _texts(content):
        if any(not c.isprintable() and c not in "\n\t" for c in text):
            yield f"the text {text[:100]!r} has control characters"
    scene, splits = results.scene, ("train", "test")
    for split in splits:
        rows: dict[str, Scores] = getattr(results.views, split)
        named: tuple[str, ...] = getattr(scene, split) if scene else ()
        if named and "views" in results.model_fields_set and tuple(rows) != named:
            yield f"views.{split} are not the scene's {split} views"
        if rows:
            yield from _wrong_means(split, getattr(results, split), rows, results.unavailable)


def _wrong_means(
    split: str, means: Scores, rows: Mapping[str, Scores], unavailable: Mapping[str, str]
) -> Iterator[str]:
    names = dict.fromkeys(name for row in rows.values() for name in row)
    if names.keys() != means.keys():
        yield f"{split} has other metrics than its views"
        return
    for name in names:
        values = [row[name] for row in rows.values() if name in row]
        known = [value for value in values if value is not None]
        expected = sum(known) / len(known) if known else None
        infinite = len(known) < len(values) and name not in unavailable
        if infinite or (expected is not None and not math.isfinite(expected)):
            expected = None
        if not _alike(means[name], expected):
            yield f"{split}.{name} is {means[name]}, the mean of its views is {expected}"


def _alike(one: Score, other: Score) -> bool:
    if one is None or other is None:
        return one is other
    return math.isclose(one, other, rel_tol=TOLERANCE, abs_tol=1e-12)


def _texts(value: Any) -> Iterator[str]:
    """Every key and text in a JSON value."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for key, child in value.items():
            yield key
            yield from _texts(child)
    elif isinstance(value, list):
        for child in value:
            yield from _texts(child)
