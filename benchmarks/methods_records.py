"""What is kept of a training of `benchmarks.methods`: a JSON file each, in the repository."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.methods_plan import MethodRun
from registry import RunError
from registry.system.files import write_json

RECORDS = Path(__file__).parent / "records" / "methods"


@dataclass(frozen=True)
class Record:
    """A training and what it measured (`benchmarks.methods_run.measure`)."""

    run: MethodRun
    measured: dict[str, Any]

    @property
    def scores(self) -> dict[str, float]:
        """Means over the test views by metric."""
        return dict(self.measured["scores"])


def save(run: MethodRun, measured: dict[str, Any], folder: Path) -> None:
    """Write a record."""
    identity = {
        "method": run.method.file.stem,
        "points": run.points,
        "data": run.data,
        "seed": run.seed,
        "pipeline": run.digest,
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / f"{run.name}.json", identity | measured)


def read(runs: Iterable[MethodRun], folder: Path) -> list[Record]:
    """The records that are there of these runs; those of a pipeline that has changed since are not.

    Raises:
        RunError: a file cannot be read.
    """
    records = []
    for run in runs:
        file = folder / f"{run.name}.json"
        if file.is_file():
            try:
                found = json.loads(file.read_text("utf-8"))
                current = found.pop("pipeline") == run.digest
            except (OSError, ValueError, KeyError, AttributeError, TypeError) as error:
                raise RunError(
                    f"the record cannot be read: {error}", where=str(file), fix="remove the file"
                ) from error
            if current:
                records.append(Record(run, found))
    return records
