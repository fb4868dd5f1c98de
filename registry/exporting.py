"""Export of a run with a single exporter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch

from core_rasterizer import GaussianModel, Gaussians

from .calls.read_only_guard import ReadOnlyGuard, of_scene
from .errors import RunError
from .messages.suggestions import did_you_mean, listing
from .pipeline.parts import build_part
from .pipeline.pipeline import Item
from .runs.results import existing_files
from .runs.run import Run
from .training.initial_model import new_model


def export(run: Run, exporter: Item, folder: Path, without: Sequence[str] = ()) -> list[Path]:
    """Write the Gaussians of a run with an exporter, and return the files.

    Args:
        folder: created if missing.
        without: kinds of initial points whose descendants are left out (`Run.kinds`).

    Raises:
        ExplainedError: an unknown kind, no Gaussian remains, or the exporter failed.
    """
    model = _without(run, without)
    folder.mkdir(parents=True, exist_ok=True)
    part = build_part(exporter, run.pipeline.training.seed, run.model.device)
    lent = of_scene(run.scene) + ReadOnlyGuard(models=(model,))
    with part.at_work(lent=lent):
        return existing_files(part.component.export(model.reader(), run.scene, folder))


def _without(run: Run, kinds: Sequence[str]) -> GaussianModel:
    """Return the Gaussians except those of some kinds."""
    if not kinds:
        return run.model
    known = run.kinds
    unknown = [kind for kind in kinds if kind not in known]
    if unknown:
        raise RunError(
            f"the run's Gaussians have no kind {unknown[0]!r}{did_you_mean(unknown[0], known)}",
            where="--without",
            fix=f"kinds: {listing(known)}"
            if known
            else "its initializer does not distinguish kinds, or an older version trained it",
        )
    left_out = torch.stack([known[kind] for kind in kinds]).any(dim=0)
    if left_out.all():
        raise RunError(
            "no Gaussian would remain",
            where=f"--without {','.join(kinds)}",
            fix="name fewer kinds",
        )
    kept = {name: values[~left_out] for name, values in vars(run.model.gaussians()).items()}
    return new_model(Gaussians(**kept), run.pipeline.training, run.model.device)
