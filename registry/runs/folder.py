"""The run folder: all files of a run. It is created only if the run can begin.

pipeline.yaml     the pipeline with every default
provenance.json   versions, commit, device, platform, seed, command line
inputs.json       digests of the inputs, see origin.py
initialization/   facts and pictures of the initializer
metrics.jsonl     one line every 50 iterations
checkpoint/       the two newest checkpoints, see training/checkpoint.py
renders/          pictures of the test views
exports/          files of exporters
observers/        files of observers
failures/         failed iterations, see replay.py
results.json      scores and measurements, written after training
"""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field, ValidationError

from ..errors import RunError
from ..system.files import jsonable, new_folder, remove_leftovers, write_json, write_text
from ..system.lock import locked
from .results_file import Amount, Record, Results, read_results

if TYPE_CHECKING:
    from torch import Tensor

PIPELINE = "pipeline.yaml"
PROVENANCE = "provenance.json"
INITIALIZATION = "initialization"
METRICS = "metrics.jsonl"
INPUTS = "inputs.json"
RESULTS = "results.json"

_log = logging.getLogger(__name__)


class _Provenance(Record):
    run: str = ""
    resumed: list[dict[str, Any]] = Field(default_factory=list)


class _Inputs(Record):
    digests: dict[str, str] | None = None
    changed: list[str] = Field(default_factory=list)


class _Facts(Record):
    seconds: Amount = 0.0


class RunFolder:
    """The folder of a run. The constructor does not access the disk.

    Args:
        path: path of the folder, which may not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @staticmethod
    def existing(path: Path) -> RunFolder:
        """Return the folder of a run that was started earlier.

        Raises:
            RunError: the path is not a run folder.
        """
        run = RunFolder(path)
        if not run.pipeline.is_file():
            reason = "it has no pipeline.yaml" if path.is_dir() else "there is no such folder"
            raise RunError(
                f"this is not a run folder: {reason}",
                where=str(path),
                fix="give a folder that `stereogs train` wrote",
            )
        return run

    @staticmethod
    def check_vacant(path: Path) -> None:
        """Refuse a path where a run folder cannot be created.

        Raises:
            RunError: the folder is not empty, is a file, or cannot be written.
        """
        if path.is_dir() and any(path.iterdir()):
            raise RunError(
                "the folder is not empty",
                where=str(path),
                fix=f"choose another --out, or continue with `stereogs resume {path}`",
            )
        if path.exists() and not path.is_dir():
            raise RunError("the path is a file", where=str(path), fix="choose another --out")
        parent = path.absolute().parent
        while not parent.exists():
            parent = parent.parent
        if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
            raise RunError(
                f"the folder {parent} cannot be written",
                where=str(path),
                fix="choose another --out",
            )

    def create(
        self,
        pipeline_yaml: str,
        provenance: dict[str, Any],
        inputs: Mapping[str, str],
        fill: Callable[[RunFolder], None],
    ) -> None:
        """Create the folder with its first files, completely or not at all.

        Args:
            inputs: digests by name, see `write_inputs`.
            fill: writes the other required files, among them the first checkpoint.

        Raises:
            RunError: see `check_vacant`; or writing failed.
        """
        self.check_vacant(self.path)
        try:
            with new_folder(self.path) as folder:
                write_text(folder / PIPELINE, pipeline_yaml)
                write_json(folder / PROVENANCE, provenance)
                write_json(folder / INPUTS, {"digests": inputs, "changed": []})
                fill(RunFolder(folder))
            remove_leftovers(self.path.parent, of=self.path.name)
        except OSError as error:
            raise RunError(
                f"the run folder cannot be created: {error.strerror or error}",
                where=str(self.path),
                fix="choose another --out",
            ) from error

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the lock of the folder, and remove partial files of killed processes.

        Raises:
            RunError: another process holds the lock, or the folder cannot be written.
        """
        with locked(self.path) as lock:
            if lock.killed is not None:
                _log.warning("process %d was killed while it used %s", lock.killed, self.path)
            for folder in (self.path, *(path for path in self.path.rglob("*") if path.is_dir())):
                remove_leftovers(folder)
            yield

    @property
    def identity(self) -> str:
        """Unique identifier of the run; "" for a run of an older version."""
        return str(_read_json(self.path / PROVENANCE, _Provenance).get("run", ""))

    def note_resumption(self, facts: dict[str, Any]) -> None:
        """Add the circumstances of a resumption to provenance.json."""
        origin = _read_json(self.path / PROVENANCE, _Provenance)
        if origin:
            origin["resumed"] = [*origin.get("resumed", []), facts]
            write_json(self.path / PROVENANCE, origin)

    @property
    def pipeline(self) -> Path:
        """Path of the resolved pipeline."""
        return self.path / PIPELINE

    def folder(self, name: str) -> Path:
        """Return a folder inside, created if missing."""
        folder = self.path / name
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def write_inputs(self, digests: Mapping[str, str], changed: Sequence[str]) -> None:
        """Write the digests of the current inputs, and the names of all inputs that ever changed."""
        write_json(self.path / INPUTS, {"digests": digests, "changed": list(changed)})

    def inputs(self) -> tuple[dict[str, str] | None, list[str]]:
        """Return the digests of the inputs, None for a run of an older version, and the changed inputs.

        Raises:
            RunError: inputs.json is damaged.
        """
        content = _read_json(self.path / INPUTS, _Inputs)
        return content.get("digests"), content.get("changed", [])

    def write_results(self, results: Results) -> None:
        """Replace results.json."""
        write_json(self.path / RESULTS, jsonable(results.plain()))

    def results(self) -> dict[str, Any]:
        """Return the content of results.json, empty before the run has ended.

        Raises:
            RunError: it is inconsistent; see `read_results`.
        """
        path = self.path / RESULTS
        return read_results(path) if path.exists() else {}

    def write_initialization(self, facts: dict[str, Any], pictures: Mapping[str, Tensor]) -> None:
        """Write the facts and pictures of the initializer.

        Args:
            pictures: `[H, W, 3]` in [0, 1] by file name without suffix.
        """
        from ..system.parallel import in_parallel
        from ..toolkit.drawing.pictures import save_png

        folder = self.folder(INITIALIZATION)
        write_json(folder / "facts.json", facts)
        in_parallel(lambda name: save_png(pictures[name], folder / f"{name}.png"), [*pictures])

    def initialization(self) -> dict[str, Any]:
        """Return the facts of the initializer, empty if missing.

        Raises:
            RunError: facts.json is damaged.
        """
        return _read_json(self.path / INITIALIZATION / "facts.json", _Facts)

    def append_metrics(self, line: dict[str, Any]) -> None:
        """Add one line to metrics.jsonl.

        Raises:
            RunError: writing failed.
        """
        path = self.path / METRICS
        try:
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
        except OSError as error:
            raise RunError(
                f"the metrics cannot be written: {error.strerror or error}",
                where=str(path),
                fix=f"free some disk space; `stereogs resume {self.path}` continues the run",
            ) from error

    def forget_metrics_after(self, iteration: int) -> None:
        """Remove the lines of iterations that a resumed run will repeat."""
        path = self.path / METRICS
        if not path.is_file():
            return
        lines = path.read_text("utf-8", errors="replace").splitlines()
        kept = [line for line in lines if _until(line, iteration)]
        write_text(path, "".join(f"{line}\n" for line in kept))


def _read_json(path: Path, record: type[Record]) -> dict[str, Any]:
    """Return the content of a JSON file, empty if it is missing.

    Raises:
        RunError: it is not JSON, or does not match the record.
    """
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text("utf-8"))
        record.model_validate(content, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "all of it"
        raise _damaged(path, f"{place}: {first['msg']}") from error
    except (ValueError, RecursionError) as error:
        raise _damaged(path, str(error)) from error
    return dict(content)


def _damaged(path: Path, what: str) -> RunError:
    fix = "restore it from a backup"
    return RunError(f"{path.name} is damaged: {what}", where=str(path), fix=fix)


def default_folder(name: str, taken: Callable[[Path], bool] = Path.exists) -> Path:
    """Return runs/<name>, or runs/<name>-2, -3, ... if that exists.

    Args:
        name: any text; characters that are unsafe in a file name become "-".
    """
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.") or "run"
    candidate, number = Path("runs", plain), 1
    while taken(candidate):
        number += 1
        candidate = Path("runs", f"{plain}-{number}")
    return candidate


def _until(line: str, iteration: int) -> bool:
    try:
        return bool(json.loads(line)["iteration"] <= iteration)
    except (ValueError, KeyError, TypeError, RecursionError):  # cut off by a power failure
        return False
