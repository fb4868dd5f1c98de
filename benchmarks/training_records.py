"""Records of trainings: a JSON Lines file for each campaign, in `benchmarks/records`.

A line holds one training; lines are sorted by name. `save` rewrites the file atomically, so a reader finds
either the old or the new file. A campaign has one writer: its trainings run in other processes and only
report, and a lock keeps a second command out (`benchmarks.campaign`).
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic

from benchmarks.planned_training import Planned
from registry import RunError
from registry.system.files import write_text

RECORDS = Path(__file__).parent / "records"


@dataclass(frozen=True)
class Record(Generic[Planned]):
    """A training and its measurements (`benchmarks.training_process.measure`)."""

    run: Planned
    measured: dict[str, Any]

    @property
    def scores(self) -> dict[str, float]:
        """Means over the test views by metric."""
        return dict(self.measured["scores"])


def processor(record: Record[Any]) -> str:
    """Return the device, the processor's family and model, and the target of its kernels, as far as known.

    A driver may give processors of several generations the same name.
    """
    device = record.measured["device"]
    name = str(device["name"]).removeprefix("pthread-")
    target = device.get("built_for")
    known = [record.measured.get("processor_model"), f"kernels for {target}" if target else None]
    details = ", ".join(text for text in known if text)
    return f"{name} ({details})" if details else name


def save(run: Planned, measured: dict[str, Any], file: Path) -> None:
    """Add a record; it replaces an older one of the same name.

    Raises:
        RunError: the file cannot be read.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    lines = _lines(file)
    identity = {"name": run.name, **run.identity, "pipeline": run.digest}
    lines[run.name] = json.dumps(identity | measured)
    write_text(file, "".join(f"{lines[name]}\n" for name in sorted(lines)))


def read(runs: Iterable[Planned], file: Path) -> list[Record[Planned]]:
    """Return the records of these runs, without those of a pipeline that has changed since.

    Raises:
        RunError: the file cannot be read.
    """
    lines = _lines(file)
    records = []
    for run in runs:
        if run.name in lines:
            found = json.loads(lines[run.name])
            del found["name"]
            if found.pop("pipeline") == run.digest:
                records.append(Record(run, found))
    return records


def _lines(file: Path) -> dict[str, str]:
    """The lines of a file by the name of their training."""
    if not file.is_file():
        return {}
    try:
        lines = file.read_text("utf-8").splitlines()
        return {json.loads(line)["name"]: line for line in lines}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(
            f"the records cannot be read: {error}", where=str(file), fix="restore the file"
        ) from error
