"""What is kept of a training: a JSON file each, in the repository."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic

from benchmarks.planned_training import Planned
from registry import RunError
from registry.system.files import write_json

RECORDS = Path(__file__).parent / "records"


@dataclass(frozen=True)
class Record(Generic[Planned]):
    """A training and what it measured (`benchmarks.training_process.measure`)."""

    run: Planned
    measured: dict[str, Any]

    @property
    def scores(self) -> dict[str, float]:
        """Means over the test views by metric."""
        return dict(self.measured["scores"])


def processor(record: Record[Any]) -> str:
    """What it was trained on: the device, the processor's family and model, and what its kernels were
    built for, as far as these are known.

    A driver may call processors of several generations by one name.
    """
    device = record.measured["device"]
    name = str(device["name"]).removeprefix("pthread-")
    told = device.get("built_for")
    known = [record.measured.get("processor_model"), f"kernels for {told}" if told else None]
    details = ", ".join(text for text in known if text)
    return f"{name} ({details})" if details else name


def save(run: Planned, measured: dict[str, Any], folder: Path) -> None:
    """Write a record."""
    folder.mkdir(parents=True, exist_ok=True)
    identity = run.identity | {"pipeline": run.digest}
    write_json(folder / f"{run.name}.json", identity | measured)


def read(runs: Iterable[Planned], folder: Path) -> list[Record[Planned]]:
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
