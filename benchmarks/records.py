"""Records of trainings and other measurements: JSON Lines files in `benchmarks/records`.

A line holds one measurement. A campaign's lines are sorted by name; its trainings run in other processes and
only report, and a lock keeps a second command out (`benchmarks.campaign`). Other benchmarks append lines.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic

from benchmarks.trainings import AnyTraining
from registry import RunError
from registry.system.files import write_text

RECORDS = Path(__file__).parent / "records"


@dataclass(frozen=True)
class Record(Generic[AnyTraining]):
    """A training and its measurements (`benchmarks.training_process.measure`)."""

    run: AnyTraining
    measured: dict[str, Any]

    @property
    def scores(self) -> dict[str, float]:
        """Means over the test views by metric."""
        return dict(self.measured["scores"])

    @property
    def processor(self) -> str:
        """The device, the processor's family and model, and the target of its kernels, as far as known.

        A driver may give processors of several generations the same name.
        """
        device = self.measured["device"]
        name = str(device["name"]).removeprefix("pthread-")
        target = device.get("built_for")
        known = [self.measured.get("processor_model"), f"kernels for {target}" if target else None]
        details = ", ".join(text for text in known if text)
        return f"{name} ({details})" if details else name


def save(run: AnyTraining, measured: Mapping[str, Any], file: Path) -> None:
    """Add a record; it replaces an older one of the same name. A reader finds the old or the new file.

    Raises:
        RunError: the file cannot be read.
    """
    found = {line["name"]: line for line in lines(file)}
    found[run.name] = {"name": run.name, **run.identity, "pipeline": run.digest, **measured}
    file.parent.mkdir(parents=True, exist_ok=True)
    write_text(file, "".join(f"{json.dumps(found[name])}\n" for name in sorted(found)))


def read(runs: Iterable[AnyTraining], file: Path) -> list[Record[AnyTraining]]:
    """Return the records of these runs, without those of a pipeline that has changed since.

    Raises:
        RunError: the file cannot be read.
    """
    found = {line.pop("name"): line for line in lines(file)}
    return [
        Record(run, found[run.name])
        for run in runs
        if run.name in found and found[run.name].pop("pipeline") == run.digest
    ]


def lines(file: Path) -> Iterator[dict[str, Any]]:
    """Yield the records of a file, none without the file.

    Raises:
        RunError: the file cannot be read.
    """
    try:
        for line in file.read_text("utf-8").splitlines() if file.is_file() else ():
            yield {**json.loads(line)}
    except (OSError, ValueError, TypeError) as error:
        raise RunError(
            f"the records cannot be read: {error}", where=str(file), fix="restore the file"
        ) from error


def append(record: Mapping[str, Any], file: Path) -> None:
    """Append a record to a file."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a", encoding="utf-8") as lines:
        lines.write(json.dumps(record) + "\n")
