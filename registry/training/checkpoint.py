"""Checkpoints: tensors in safetensors, the rest in a JSON manifest that is written last.

`manifest.json` names the tensor file that belongs to it. Both are written beside their place and
renamed, the manifest after the tensors, so that at every moment the folder holds one whole
checkpoint: the old one or the new one.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from ..errors import RunError
from ..files import replacing, write_json

FORMAT = 1
"""Raised when older checkpoints can no longer be read."""
_MANIFEST = "manifest.json"


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A moment between two iterations.

    Args:
        iteration: the last one that is complete.
        seconds: spent training until then.
        tensors: all state, by slash-separated names such as "model/means".
    """

    iteration: int
    seconds: float
    tensors: dict[str, Tensor]

    def part(self, prefix: str) -> dict[str, Tensor]:
        """The tensors whose names begin with `prefix/`, without it."""
        start = f"{prefix}/"
        return {k.removeprefix(start): v for k, v in self.tensors.items() if k.startswith(start)}


def save_checkpoint(checkpoint: Checkpoint, folder: Path) -> None:
    """Replace the checkpoint in `folder`, which exists.

    Raises:
        RunError: the disk refused; an older checkpoint is still whole.
    """
    name = f"iteration-{checkpoint.iteration:07d}.safetensors"
    manifest = {
        "format": FORMAT,
        "iteration": checkpoint.iteration,
        "seconds": checkpoint.seconds,
        "tensors": name,
    }
    try:
        with replacing(folder / name) as temporary:
            save_file({k: v.contiguous() for k, v in checkpoint.tensors.items()}, temporary)
        write_json(folder / _MANIFEST, manifest)
    except (OSError, SafetensorError) as error:
        raise RunError(
            f"the checkpoint cannot be written: {error}",
            where=str(folder),
            fix="free some disk space; the checkpoint before it is still whole",
        ) from error
    for old in folder.glob("iteration-*.safetensors"):
        if old.name != name:
            old.unlink(missing_ok=True)


def load_checkpoint(folder: Path) -> Checkpoint:
    """Read the checkpoint in `folder`.

    Raises:
        RunError: there is none, or it is damaged or of another format.
    """
    path = folder / _MANIFEST
    try:
        manifest: dict[str, Any] = json.loads(path.read_text("utf-8"))
        if manifest["format"] != FORMAT:
            raise RunError(
                f"the checkpoint has format {manifest['format']}, this version reads {FORMAT}",
                where=str(path),
                fix="resume it with the version that wrote it; provenance.json says which",
            )
        tensors = load_file(folder / Path(manifest["tensors"]).name)
        return Checkpoint(int(manifest["iteration"]), float(manifest["seconds"]), tensors)
    except FileNotFoundError as error:
        raise RunError(
            "the run has no checkpoint to continue from",
            where=str(folder),
            fix="train it anew into another folder",
        ) from error
    except (OSError, ValueError, KeyError, TypeError, SafetensorError) as error:
        raise RunError(
            f"the checkpoint cannot be read: {error}",
            where=str(folder),
            fix="the file is damaged; train anew into another folder",
        ) from error
