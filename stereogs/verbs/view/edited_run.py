"""Save the Gaussians that remain after an edit as a new run."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from registry import RunError
from registry.runs.outputs import renew
from registry.runs.progress import SUMS
from registry.training.assembly import restore
from registry.training.checkpoint import EDITS

from .edits import unused

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

    from registry.runs.run import Run

EDITOR = "stereogs view"


def save_edited(run: Run, kept: Tensor) -> Path:
    """Write a part of a run's Gaussians as a new run beside it, and return its folder.

    Its state is that of training after the same edit: an unfinished run can be resumed. It is scored and
    exported anew; curves of the training are not copied. Its provenance and results name the edit.

    Args:
        kept: mask `[N]` bool.

    Raises:
        ExplainedError: photographs or a plugin of the run are not here, a component fails, or none is kept.
    """
    if not run.photographs:
        raise RunError(
            "the photographs of the run are not here, so what remains cannot be scored",
            fix="save as PLY, or open the run with `--scene FOLDER`",
        )
    for missing in run.pipeline.missing.values():
        raise missing
    folder, before = run.folder_or_refuse(), run.checkpoint()
    parts = run.parts.following(run.pipeline)
    trainer = restore(parts, run.scene, before)
    trainer.fields[0].prune(~kept, run.iteration)
    note = {
        "run": run.identity,
        "folder": folder.path.name,
        "hash": run.hash,
        "gaussians": len(kept),
        "removed": int((~kept).sum()),
        "by": EDITOR,
    }
    edits = [*run.edits, note]
    sums = {name: sum_ for name, sum_ in before.tensors.items() if name.startswith(f"{SUMS}/")}
    notes = {**before.notes, EDITS: edits}
    after = replace(before, tensors=trainer.state() | sums, notes=notes)
    edited = replace(
        run,
        parts=parts,
        engine_model=trainer.model,
        checkpoint=lambda: after,
        folder=None,
        metrics=[],
        edits=edits,
        _scores=None,
    )
    edited.keep_in(path := unused(folder.lasting, ""))
    written = edited.folder_or_refuse()
    inputs, changed = folder.inputs()
    if inputs is not None:
        written.write_inputs(inputs, changed)
    renew(edited, written)
    return path
