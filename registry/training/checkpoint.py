"""Checkpoints: everything that the next iteration depends on, written atomically and verified when read.

    iteration-0000500/
        manifest.json          the iteration, the other files' SHA-256, and a SHA-256 of itself
        pipeline.yaml          the pipeline with every default
        tensors.safetensors    all state

A checkpoint is written to a temporary folder, flushed, and renamed. The previous one is kept: a damaged file
costs a few iterations, not the run.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from core_rasterizer import ExplainedError, Gaussians

from ..contract.frame import IN_FILE, Frame
from ..errors import RunError
from ..system.files import flush, flush_folder, new_folder, write_json, write_text

CHECKPOINT = "checkpoint"
"""Name of the folder in a run folder."""
FORMAT = 2
"""Incremented when older checkpoints can no longer be read."""
FRAME = "frame"
"""Name of the tensor `[4]` float64 with the centre and the unit of the frame of training."""
RECOVERIES = "recoveries"
"""Name of the note with the recoveries of the run so far."""
EDITS = "edits"
"""Name of the note with the edits of the run by hand."""
_MANIFEST, _PIPELINE, _TENSORS = "manifest.json", "pipeline.yaml", "tensors.safetensors"
_NAME = re.compile(r"iteration-([0-9]{7,})(?:-([0-9]+))?")
_log = logging.getLogger(__name__)


def rates_after(recoveries: Sequence[object]) -> float:
    """Factor of the learning rates: each recovery halves them."""
    return 0.5 ** len(recoveries)


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """State between two iterations.

    Args:
        iteration: the last complete iteration; 0 before the first.
        seconds: training time so far.
        tensors: all state, by slash-separated names such as "model/means".
        pipeline: the resolved pipeline as YAML.
        run: unique identifier of the run; "" for a run without a folder.
        notes: additional JSON values.
    """

    iteration: int
    seconds: float
    tensors: dict[str, Tensor]
    pipeline: str
    run: str = ""
    notes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def frame(self) -> Frame:
        """The frame of training; checkpoints of older versions have the file's."""
        if FRAME not in self.tensors:
            return IN_FILE
        x, y, z, unit = self.tensors[FRAME].tolist()
        return Frame((x, y, z), unit)

    def part(self, prefix: str) -> dict[str, Tensor]:
        """Return the tensors whose names begin with `prefix/`, without the prefix."""
        start = f"{prefix}/"
        return {k.removeprefix(start): v for k, v in self.tensors.items() if k.startswith(start)}


def save_checkpoint(checkpoint: Checkpoint, folder: Path) -> None:
    """Add a checkpoint to `folder`, created if missing; remove all but this one and the previous one.

    Raises:
        RunError: writing failed; earlier checkpoints are intact.
    """
    name = f"iteration-{checkpoint.iteration:07d}"
    place, number = folder / name, 1
    while place.exists():  # damaged, or from before the run was resumed at an earlier iteration
        number += 1
        place = folder / f"{name}-{number}"
    write_checkpoint(checkpoint, place)
    places = _places(folder)
    here = places.index(place)
    for superseded in (*places[: max(0, here - 1)], *places[here + 1 :]):
        shutil.rmtree(superseded, ignore_errors=True)


def load_checkpoint(folder: Path) -> Checkpoint:
    """Read the newest intact checkpoint in `folder`; log a warning for damaged ones.

    Raises:
        RunError: all checkpoints are missing or damaged; describes the newest.
    """
    refused: RunError | None = None
    for place in reversed(_places(folder)):
        try:
            checkpoint = read_checkpoint(place)
        except RunError as error:
            refused = refused or error
            continue
        if refused is not None:
            message = "%s (%s); continuing from the previous one, after iteration %d"
            _log.warning(message, refused.what, refused.where, checkpoint.iteration)
        return checkpoint
    raise refused or RunError(
        "the run has no checkpoint to continue from",
        where=str(folder),
        fix="train again into another folder",
    )


def trained_gaussians(run: Path) -> Gaussians:
    """Return the Gaussians of the newest intact checkpoint in a run folder.

    Raises:
        RunError: the folder has no checkpoint, or its Gaussians are inconsistent.
    """
    with explain_misfit(run / CHECKPOINT):
        return Gaussians(**load_checkpoint(run / CHECKPOINT).part("model"))


def write_checkpoint(checkpoint: Checkpoint, place: Path) -> None:
    """Write one checkpoint to a new path, completely or not at all; a RunError explains why not."""
    try:
        with new_folder(place) as inside:
            save_file(_unshared(checkpoint.tensors), inside / _TENSORS)
            flush(inside / _TENSORS)
            write_text(inside / _PIPELINE, checkpoint.pipeline)
            manifest = {
                "format": FORMAT,
                "iteration": checkpoint.iteration,
                "seconds": checkpoint.seconds,
                "run": checkpoint.run,
                "notes": dict(checkpoint.notes),
                "files": {name: _sha256(inside / name) for name in (_PIPELINE, _TENSORS)},
            }
            write_json(inside / _MANIFEST, {**manifest, "sha256": _digest(manifest)})
            flush_folder(inside)
        flush_folder(place.parent)
    except (OSError, SafetensorError) as error:
        before = _places(place.parent)
        rest = f"; then `stereogs resume {place.parent.parent}`" if before else ""
        raise RunError(
            f"the checkpoint cannot be written: {error}",
            where=str(place),
            fix=f"free some disk space, or check the permissions{rest}",
        ) from error


def _unshared(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Clone tensors that share memory, such as one depth map of two views: safetensors refuses them."""
    result: dict[str, Tensor] = {}
    memory = set[int]()
    for name, value in tensors.items():
        whole = value.contiguous()
        place = whole.untyped_storage().data_ptr()
        result[name] = whole.clone() if place in memory else whole
        memory.add(place)
    return result


def read_checkpoint(place: Path) -> Checkpoint:
    """Read one checkpoint, and verify every bit of it.

    Raises:
        RunError: it is damaged, or has another format.
    """
    try:
        for name in (_MANIFEST, _PIPELINE, _TENSORS):
            if not (place / name).is_file():  # reading a pipe would not end
                raise ValueError(f"{name} is missing, or not a file")
        manifest = json.loads((place / _MANIFEST).read_bytes())
        if manifest["format"] != FORMAT:
            raise RunError(
                f"the checkpoint has format {manifest['format']!r}, this version reads {FORMAT}",
                where=str(place),
                fix="resume it with the version that wrote it, see provenance.json",
            )
        if manifest.pop("sha256") != _digest(manifest):
            raise ValueError(f"{_MANIFEST} was changed after it was written")
        for name in (_PIPELINE, _TENSORS):
            if manifest["files"][name] != _sha256(place / name):
                raise ValueError(f"{name} was changed after it was written")
        iteration, seconds = manifest["iteration"], float(manifest["seconds"])
        if type(iteration) is not int or iteration < 0 or not 0 <= seconds < math.inf:
            raise ValueError(f"the iteration is {iteration!r}, the seconds are {seconds!r}")
        return Checkpoint(
            iteration=iteration,
            seconds=seconds,
            tensors=load_file(place / _TENSORS),
            pipeline=(place / _PIPELINE).read_text("utf-8"),
            run=str(manifest["run"]),
            notes=dict(manifest["notes"]),
        )
    except RunError:
        raise
    except Exception as error:  # json, safetensors and the disk have many errors for damaged files
        raise RunError(
            f"the checkpoint is damaged: {_first_line(error)}",
            where=str(place),
            fix="restore the file from a backup, or train again into another folder",
        ) from error


@contextmanager
def explain_misfit(place: Path) -> Iterator[None]:
    """Explain exceptions of a block that restores the state of a checkpoint.

    Raises:
        ExplainedError: raised by a component; `place` is added.
        RunError: any other exception.
    """
    try:
        yield
    except ExplainedError as error:
        error.where = f"{error.where}; from {place}" if error.where else str(place)
        raise
    except Exception as error:
        raise RunError(
            f"the checkpoint does not match this pipeline: "
            f"{type(error).__name__}: {_first_line(error)}",
            where=str(place),
            fix="resume it with the version that wrote it, see provenance.json",
        ) from error


def _places(folder: Path) -> list[Path]:
    """Return the checkpoints in a folder, the newest last."""
    if not folder.is_dir():
        return []
    found = ((_NAME.fullmatch(path.name), path) for path in folder.iterdir())
    order = {path: (int(name[1]), int(name[2] or 1)) for name, path in found if name}
    return sorted(order, key=order.__getitem__)


def _sha256(file: Path) -> str:
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def _digest(manifest: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the content, independent of the layout."""
    return hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
