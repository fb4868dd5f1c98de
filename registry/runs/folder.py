"""The run folder: everything that a run leaves behind, and nothing if it could not begin.

pipeline.yaml     the pipeline with every default written out
provenance.json   versions, commit, device, platform, seed, command line
inputs.json       digests of what it was made from, see inputs.py
initialization/   what the initializer reports: facts.json and pictures
metrics.jsonl     one line every few iterations
checkpoint/       the two newest moments to resume from (see training/checkpoint.py)
renders/          the test views; exports/  what the exporters wrote
observers/        what loggers and other observers wrote
failures/         iterations that failed, to be repeated (see replay.py)
results.json      scores and measurements, once training has ended
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

from pydantic import BaseModel, ConfigDict, ValidationError

from ..errors import RunError
from ..system.files import new_folder, remove_leftovers, write_json, write_text
from .guarding.lock import locked
from .results_file import Amount, read_results

if TYPE_CHECKING:
    from torch import Tensor

PIPELINE = "pipeline.yaml"
PROVENANCE = "provenance.json"
INITIALIZATION = "initialization"
METRICS = "metrics.jsonl"
INPUTS = "inputs.json"
RESULTS = "results.json"

_log = logging.getLogger(__name__)


class _Record(BaseModel):
    """What is read of a small JSON file; more may stand there."""

    model_config = ConfigDict(extra="allow", strict=True)


class _Provenance(_Record):
    run: str = ""
    resumed: list[dict[str, Any]] = []


class _Inputs(_Record):
    digests: dict[str, str] | None = None
    changed: list[str] = []


class _Facts(_Record):
    seconds: Amount = 0.0


class RunFolder:
    """A run's folder. Constructing it touches nothing; `create` and `existing` do.

    Args:
        path: where it is, or will be.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @staticmethod
    def existing(path: Path) -> RunFolder:
        """The folder of a run that was started earlier.

        Raises:
            RunError: there is none.
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
        """Refuse a place where no run can be created; creates nothing itself.

        Raises:
            RunError: the folder has content, is a file, or cannot be written.
        """
        if path.is_dir() and any(path.iterdir()):
            raise RunError(
                "the folder is not empty",
                where=str(path),
                fix=f"choose another --out, or continue with `stereogs resume {path}`",
            )
        if path.exists() and not path.is_dir():
            raise RunError("a file is in the way", where=str(path), fix="choose another --out")
        parent = path.absolute().parent
        while not parent.exists():
            parent = parent.parent
        if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
            raise RunError(
                f"nothing can be written in {parent}", where=str(path), fix="choose another --out"
            )

    def create(
        self,
        pipeline_yaml: str,
        provenance: dict[str, Any],
        inputs: Mapping[str, str],
        fill: Callable[[RunFolder], None],
    ) -> None:
        """Make the folder with its first files; all or nothing.

        Args:
            inputs: digests by name, see `write_inputs`.
            fill: writes what else the folder must never be without, above all the first checkpoint.

        Raises:
            RunError: see `check_vacant`; or the disk refused.
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
    def to_itself(self) -> Iterator[None]:
        """Keep other processes from training or scoring this run; clear away what a kill has left.

        Raises:
            RunError: another process works on it, or nothing can be written there.
        """
        with locked(self.path) as lock:
            if lock.taken_over is not None:
                _log.warning(
                    "process %d was killed while it worked in %s", lock.taken_over, self.path
                )
            for folder in (self.path, *(path for path in self.path.rglob("*") if path.is_dir())):
                remove_leftovers(folder)
            yield

    @property
    def identity(self) -> str:
        """What tells this run from others that were made alike; "" for one of an older version."""
        return str(_read_json(self.path / PROVENANCE, _Provenance).get("run", ""))

    def note_resumption(self, facts: dict[str, Any]) -> None:
        """Add to provenance.json what a run goes on with."""
        origin = _read_json(self.path / PROVENANCE, _Provenance)
        if origin:
            origin["resumed"] = [*origin.get("resumed", []), facts]
            write_json(self.path / PROVENANCE, origin)

    @property
    def pipeline(self) -> Path:
        """The resolved pipeline."""
        return self.path / PIPELINE

    def folder(self, name: str) -> Path:
        """A folder inside, created if need be."""
        folder = self.path / name
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def write_inputs(self, digests: Mapping[str, str], changed: Sequence[str]) -> None:
        """Keep other inputs than before, and what has changed on the way."""
        write_json(self.path / INPUTS, {"digests": digests, "changed": list(changed)})

    def inputs(self) -> tuple[dict[str, str] | None, list[str]]:
        """The digests of the inputs, None if an older version kept none, and what has changed.

        Raises:
            RunError: they are none.
        """
        content = _read_json(self.path / INPUTS, _Inputs)
        return content.get("digests"), content.get("changed", [])

    def write_results(self, results: dict[str, Any]) -> None:
        """Replace results.json."""
        write_json(self.path / RESULTS, results)

    def results(self) -> dict[str, Any]:
        """What results.json holds; empty before the run has ended.

        Raises:
            RunError: it cannot be believed; see `read_results`.
        """
        path = self.path / RESULTS
        return read_results(path) if path.exists() else {}

    def write_initialization(self, facts: dict[str, Any], pictures: Mapping[str, Tensor]) -> None:
        """Keep what the initializer reports.

        Args:
            pictures: `[H, W, 3]` in [0, 1] by file name without ending.
        """
        from ..system.parallel import in_parallel
        from ..toolkit.drawing.pictures import save_png

        folder = self.folder(INITIALIZATION)
        write_json(folder / "facts.json", facts)
        in_parallel(lambda name: save_png(pictures[name], folder / f"{name}.png"), [*pictures])

    def initialization(self) -> dict[str, Any]:
        """The facts that `write_initialization` kept; empty if there are none.

        Raises:
            RunError: they are none.
        """
        return _read_json(self.path / INITIALIZATION / "facts.json", _Facts)

    def append_metrics(self, line: dict[str, Any]) -> None:
        """Add one line to metrics.jsonl.

        Raises:
            RunError: the disk refused.
        """
        path = self.path / METRICS
        try:
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
        except OSError as error:
            raise RunError(
                f"the metrics cannot be written: {error.strerror or error}",
                where=str(path),
                fix=f"free some disk space; `stereogs resume {self.path}` goes on",
            ) from error

    def forget_metrics_after(self, iteration: int) -> None:
        """Drop the lines of iterations that a resumed run will do again."""
        path = self.path / METRICS
        if not path.is_file():
            return
        lines = path.read_text("utf-8", errors="replace").splitlines()
        kept = [line for line in lines if _until(line, iteration)]
        write_text(path, "".join(f"{line}\n" for line in kept))


def _read_json(path: Path, record: type[_Record]) -> dict[str, Any]:
    """The content of a JSON file; empty if there is none.

    Raises:
        RunError: it is no JSON, or not what the record says.
    """
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text("utf-8"))
        record.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "all of it"
        raise _damaged(path, f"{place}: {first['msg']}") from error
    except (ValueError, RecursionError) as error:
        raise _damaged(path, str(error)) from error
    return dict(content)


def _damaged(path: Path, what: str) -> RunError:
    fix = "bring it back from a copy"
    return RunError(f"{path.name} is damaged: {what}", where=str(path), fix=fix)


def default_folder(name: str, taken: Callable[[Path], bool] = Path.exists) -> Path:
    """runs/<name>, or runs/<name>-2, -3, ... if that exists.

    Args:
        name: any text; what does not belong in a file name becomes "-".
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
