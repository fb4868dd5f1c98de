"""Schema of results.json, used to write and to read it.

A run folder may come from an untrusted source, so reading checks types, ranges and consistency.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from ..errors import RunError

LARGEST = 12_000_000
"""Bytes; the scores of 10,000 views take 2 MB."""
TOLERANCE = 1e-6
"""Relative difference between a mean and that of the views, from rounding."""

Count = Annotated[int, Field(ge=0)]
Amount = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1, max_length=500)]
Score = Number | None
"""None: infinite or not available."""
ScoresByMetric = dict[Name, Score]


class Record(BaseModel):
    """A part of the file. Versions write different fields, so unknown ones are allowed."""

    model_config = ConfigDict(extra="allow")


class _Protocol(Record):
    name: Name
    modified: dict[str, Any]


def _checked_protocol(value: dict[str, Any]) -> dict[str, Any]:
    _Protocol.model_validate(value, strict=True)
    return value


class SceneRecord(Record):
    """The scene; `facts` affect scores, `notes` do not."""

    name: Name
    train: list[Name] = []
    test: list[Name] = []
    width: Count = 0
    height: Count = 0
    background: list[Number] = []
    extent: Amount = 0.0
    near: Amount = 0.0
    far: Amount = 0.0
    points: Count = 0
    image_memory_mb: Amount = 0.0
    facts: dict[Name, Any] = {}
    notes: dict[Name, Any] = {}


class ViewScores(Record):
    """Scores of each view, by split."""

    test: dict[Name, ScoresByMetric] = {}
    train: dict[Name, ScoresByMetric] = {}


class Failure(Record):
    """A metric, exporter or report that failed after training."""

    component: Name
    what: str
    where: str = ""
    fix: str = ""


class Results(Record):
    """Contents of the file, in order. A file may lack fields; `model_fields_set` holds those it has."""

    pipeline: Name = "unnamed"
    protocol: Annotated[dict[str, Any], AfterValidator(_checked_protocol)] | None = None
    scene: SceneRecord | None = None
    metrics: dict[Name, dict[str, Any]] = {}
    device: dict[Name, str] = {}
    seed: int = 0
    iterations: Count = 0
    gaussians: Count = 0
    hash: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] = "0" * 64
    initialization: dict[Name, Any] = {}
    seconds: Amount = 0.0
    seconds_total: Amount = 0.0
    stages: dict[Name, Amount] = {}
    iterations_per_second: Amount = 0.0
    peak_memory_mb: Amount | None = None
    changed_inputs: list[Name] = []
    test: ScoresByMetric = {}
    train: ScoresByMetric = {}
    views: ViewScores = ViewScores()
    unavailable: dict[Name, str] = {}
    infinite: dict[Name, dict[Name, list[Name]]] = {}
    failures: list[Failure] = []
    exports: list[Name] = []
    reports: list[Name] = []

    def plain(self) -> dict[str, Any]:
        """Return the fields that are set, as JSON values."""
        return self.model_dump(exclude_unset=True)


def read_results(path: Path) -> dict[str, Any]:
    """Read a results.json.

    Args:
        path: of the file.

    Raises:
        RunError: the file is missing, larger than 12 MB or not a JSON object; a key is repeated; a field has
            a wrong type or range; a text has control characters; a mean differs from that of the views; or
            the scored views are not those of the scene.
    """
    try:
        if not path.is_file():
            raise _refused("there is no such file", path)
        size = path.stat().st_size
        if size > LARGEST:
            raise _refused(f"it has {size:,} bytes, more than {LARGEST:,}", path)
        content: Any = json.loads(path.read_bytes(), object_pairs_hook=_unique)
        # json refuses what pydantic's parser would accept; strict mode needs JSON text again.
        results = Results.model_validate_json(json.dumps(content), strict=True)
    except OSError as error:
        raise _refused(str(error.strerror or error), path) from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "all of it"
        raise _refused(f"{place}: {first['msg']}", path) from error
    except (ValueError, RecursionError) as error:
        raise _refused(f"it is not JSON: {error}", path) from error
    problem = next(_problems(results, content), None)
    if problem is not None:
        raise _refused(problem, path)
    return dict(content)


def _refused(what: str, path: Path) -> RunError:
    return RunError(
        f"{path.name} is inconsistent: {what}",
        where=str(path),
        fix=f"remove it, and score the run again: stereogs eval {path.parent}",
    )


def _unique(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse repeated keys: parsers differ in which value they keep."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key is repeated")
    return found


def _problems(results: Results, content: Any) -> Iterator[str]:
    for text in _texts(content):
        if any(not c.isprintable() and c not in "\n\t" for c in text):
            yield f"the text {text[:100]!r} has control characters"
    for split in ("train", "test"):
        rows: dict[str, ScoresByMetric] = getattr(results.views, split)
        named: list[str] = getattr(results.scene, split, [])
        if named and "views" in results.model_fields_set and list(rows) != named:
            yield f"views.{split} are not the scene's {split} views"
        if rows:
            yield from _wrong_means(split, getattr(results, split), rows, results.unavailable)


def _wrong_means(
    split: str,
    means: ScoresByMetric,
    rows: Mapping[str, ScoresByMetric],
    unavailable: Mapping[str, str],
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
        if not _equal(means[name], expected):
            yield f"{split}.{name} is {means[name]}, the mean of its views is {expected}"


def _equal(one: Score, other: Score) -> bool:
    if one is None or other is None:
        return one is other
    return math.isclose(one, other, rel_tol=TOLERANCE, abs_tol=1e-12)


def _texts(value: Any) -> Iterator[str]:
    """Yield every key and text in a JSON value."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for key, child in value.items():
            yield key
            yield from _texts(child)
    elif isinstance(value, list):
        for child in value:
            yield from _texts(child)
