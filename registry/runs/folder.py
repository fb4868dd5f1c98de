"""The run folder: all files of a run. It is created only if the run can begin.

pipeline.yaml     the pipeline with every default
provenance.json   versions, commit, device, platform, seed, command line
inputs.json       digests of the inputs, see origin.py
cameras.json      cameras of the views, see sources/cameras.py
initialization/   facts and pictures of the initializer
metrics.jsonl     one line every 50 iterations
checkpoint/       the two newest checkpoints, see training/checkpoint.py
renders/          pictures of the test views, or of the training views if there are none
exports/          files of exporters
observers/        files of observers
failures/         failed iterations, see opening.py
results.json      scores and measurements, written after training
"""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field

from ..errors import RunError
from ..system.files import jsonable, new_folder, remove_leftovers, write_json, write_text
from ..system.lock import locked
from ..toolkit.cache.remote import url_of
from .results import Amount, Record, Results, problem_of, read_results
from .sources.remote import IS_FILE, RemoteRun, no_run, opened_copy, refuse_stored, remote_of

if TYPE_CHECKING:
    from torch import Tensor

    from ..contract.scene import Scene
    from ..pipeline.pipeline import Pipeline
    from .sources.cameras import CamerasRecord

PIPELINE = "pipeline.yaml"
PROVENANCE = "provenance.json"
INITIALIZATION = "initialization"
METRICS = "metrics.jsonl"
INPUTS = "inputs.json"
CAMERAS = "cameras.json"
RESULTS = "results.json"

ChooseFolder = Callable[["Pipeline", "Scene"], Path]
"""Returns the run folder once the scene is loaded."""
_log = logging.getLogger(__name__)


def in_runs(pipeline: Pipeline, scene: Scene) -> Path:
    """Return `runs/<pipeline>-<scene>`, or with "-2", "-3", ... if that exists.

    Characters that are unsafe in a file name become "-".
    """
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", f"{pipeline.name}-{scene.name}").strip("-.") or "run"
    names = chain([plain], (f"{plain}-{number}" for number in count(2)))
    return next(path for name in names if not (path := Path("runs", name)).exists())


def refuse_occupied(out: Path | ChooseFolder | None) -> None:
    """Refuse a run folder that is not vacant (`RunFolder.check_vacant`), before anything is loaded."""
    if out is not None:
        RunFolder.check_vacant(out if isinstance(out, Path) else Path("runs", "*"))


class _Provenance(Record):
    run: str = ""
    folder: str = ""
    folder_from_run: str = ""
    plugins: dict[str, str] = Field(default_factory=dict)
    resumed: list[dict[str, Any]] = Field(default_factory=list)


class _Inputs(Record):
    digests: dict[str, str] | None = None
    changed: list[str] = Field(default_factory=list)


class _Facts(Record):
    seconds: Amount = 0.0


class RunFolder:
    """The folder of a run, which may not exist yet; for a remote run its copy here.

    All methods raise a RunError if a file is damaged, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @staticmethod
    def existing(path: Path) -> RunFolder:
        """Return the folder of a run that was started earlier; refuse other paths."""
        if url := url_of(path):
            return RunFolder(opened_copy(url))
        run = RunFolder(path)
        if not run.pipeline.is_file():
            reason = "it has no pipeline.yaml" if path.exists() else "there is no such folder"
            raise no_run(IS_FILE if path.is_file() else reason, str(path))
        return run

    @staticmethod
    def check_vacant(path: Path) -> None:
        """Refuse a path that is a file or not empty, or cannot be written."""
        if url := url_of(path):
            refuse_stored(url)
            return
        fix = "choose another --out"
        if path.is_dir() and any(path.iterdir()):
            fix += f", or continue with `stereogs resume {path}`"
            raise RunError("the folder is not empty", where=str(path), fix=fix)
        if path.exists() and not path.is_dir():
            raise RunError("the path is a file", where=str(path), fix=fix)
        parent = next(folder for folder in path.absolute().parents if folder.exists())
        if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
            raise RunError(f"the folder {parent} cannot be written", where=str(path), fix=fix)

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
        """
        self.check_vacant(self.path)
        try:
            with new_folder(self.path) as folder:
                write_text(folder / PIPELINE, pipeline_yaml)
                write_json(folder / PROVENANCE, jsonable(provenance))
                write_json(folder / INPUTS, {"digests": inputs, "changed": []})
                fill(RunFolder(folder))
            remove_leftovers(self.path.parent, of=self.path.name)
        except (OSError, RunError) as error:
            self.check_vacant(self.path)  # another process may have taken the name
            reason = error.what if isinstance(error, RunError) else error.strerror or error
            raise RunError(
                f"the run folder cannot be created: {reason}",
                where=str(self.path),
                fix="free some disk space, or choose another --out",
            ) from error

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the lock of the folder, unless another process does; remove files of killed processes."""
        with locked(self.path) as lock:
            if lock.killed is not None:
                _log.warning("process %d was killed while it used %s", lock.killed, self.path)
            for folder in (self.path, *(path for path in self.path.rglob("*") if path.is_dir())):
                remove_leftovers(folder)
            yield

    @contextmanager
    def training(self) -> Iterator[None]:
        """Hold the lock while a run is trained; a remote run is sent at the end."""
        with self.locked():
            if self.remote is None:
                yield
                return
            self.remote.take()
            try:
                yield
            except Exception:  # of the training: send its last checkpoint, and raise it
                with suppress(RunError):
                    self.remote.try_to_send()
                raise
            self.remote.send(last=True)

    @cached_property
    def remote(self) -> RemoteRun | None:
        """The remote run of which this is a copy; None for a local run."""
        return remote_of(self.path)

    def shown(self, name: str = "") -> str:
        """Return where the folder or a file in it is, for people: for a remote run the address."""
        if self.remote is None:
            return str(self.path / name)
        return f"{self.remote.url}/{name}".rstrip("/")

    @property
    def lasting(self) -> Path:
        """The folder; for a copy that the cache may remove, one of its name in `runs`."""
        return self.path if self.remote is None else Path("runs", self.path.name)

    @cached_property
    def identity(self) -> str:
        """Unique identifier of the run; "" for a run of an older version."""
        return str(_read_json(self.path / PROVENANCE, _Provenance).get("run", ""))

    def started_in(self) -> tuple[Path, ...]:
        """Return the folders in which the run may have been started, the likeliest first.

        The run folder may have been moved together with it; none for a run of an older version.
        """
        origin = _read_json(self.path / PROVENANCE, _Provenance)
        if not origin.get("folder"):
            return ()
        return (self.path / origin["folder_from_run"]).resolve(), Path(origin["folder"])

    @property
    def plugins(self) -> dict[str, str]:
        """The package of each component when training began or was last resumed."""
        origin = _read_json(self.path / PROVENANCE, _Provenance)
        return dict([origin, *origin.get("resumed", [])][-1].get("plugins", {}))

    def note_resumption(self, facts: dict[str, Any]) -> None:
        """Add the circumstances of a resumption to provenance.json."""
        origin = _read_json(self.path / PROVENANCE, _Provenance)
        if origin:
            origin["resumed"] = [*origin.get("resumed", []), jsonable(facts)]
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
        """Write the digests of the current inputs, and add to the inputs that ever changed."""
        names = dict.fromkeys([*self.inputs()[1], *changed])
        write_json(self.path / INPUTS, {"digests": digests, "changed": [*names]})

    def inputs(self) -> tuple[dict[str, str] | None, list[str]]:
        """Return the digests of the inputs, None for a run of an older version, and the changed inputs."""
        content = _read_json(self.path / INPUTS, _Inputs)
        return content.get("digests"), content.get("changed", [])

    def write_cameras(self, cameras: CamerasRecord) -> None:
        """Write the cameras of the scene."""
        write_json(self.path / CAMERAS, cameras.model_dump())

    def cameras(self) -> dict[str, Any]:
        """Return the content of cameras.json, empty for a run of an older version."""
        from .sources.cameras import CamerasRecord

        return _read_json(self.path / CAMERAS, CamerasRecord)

    def write_results(self, results: Results) -> None:
        """Replace results.json."""
        write_json(self.path / RESULTS, jsonable(results.plain()))

    def results(self) -> dict[str, Any]:
        """Return the content of results.json, empty before the run has ended."""
        path = self.path / RESULTS
        return read_results(path) if path.exists() else {}

    def write_initialization(self, facts: dict[str, Any], pictures: Mapping[str, Tensor]) -> None:
        """Write the facts and pictures of the initializer.

        Args:
            pictures: `[H, W, 3]` in [0, 1] by file name without suffix.
        """
        from ..toolkit.drawing.pictures import save_png
        from ..toolkit.progress.parallel import in_parallel

        folder = self.folder(INITIALIZATION)
        write_json(folder / "facts.json", jsonable(facts))
        in_parallel(lambda name: save_png(pictures[name], folder / f"{name}.png"), [*pictures])

    def initialization(self) -> dict[str, Any]:
        """Return the facts of the initializer, empty if missing."""
        return _read_json(self.path / INITIALIZATION / "facts.json", _Facts)

    def append_metrics(self, line: dict[str, Any]) -> None:
        """Add one line to metrics.jsonl."""
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
        if path.is_file():
            lines = path.read_text("utf-8", errors="replace").splitlines()
            kept = [line for line in lines if _is_until(iteration, line)]
            write_text(path, "".join(f"{line}\n" for line in kept))


def _read_json(path: Path, record: type[Record]) -> dict[str, Any]:
    """Return the content of a JSON file, empty if it is missing; refuse content unlike the record."""
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text("utf-8"))
        record.model_validate(content, strict=True)
    except (ValueError, RecursionError) as error:
        raise RunError(
            f"{path.name} is damaged: {problem_of(error)}",
            where=str(path),
            fix="restore it from a backup",
        ) from error
    return dict(content)


def _is_until(iteration: int, line: str) -> bool:
    try:
        return bool(json.loads(line)["iteration"] <= iteration)
    except (ValueError, KeyError, TypeError, RecursionError):  # cut off by a power failure
        return False
