"""What observers are told of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import GaussianReader, Rendering

    from .contract.scene import TrainingScene, TrainingView

__all__ = ["IterationDone", "RunEnded", "RunStarted", "ViewsScored"]


@dataclass(frozen=True, eq=False)
class RunStarted:
    """A run begins, or goes on.

    Args:
        title: the run folder's name; the pipeline's for a run that is kept in memory.
        folder: for this observer's files: `observers/NAME` in the run folder, which exists. None for a
            run that is kept in memory and is to leave no file.
        identity: what tells the run from all others, 32 hexadecimal digits; a resumed run keeps it. Empty
            for a run in memory.
        iteration: the last one that is complete; training goes on with the next.
        resumed: whether the run was stopped before; then 0 is a possible iteration too.
        iterations: how many there will be.
        pipeline: the resolved pipeline as plain values, every default written out.
        facts: what is trained on what, as results.json will say it: scene, device, seed, ...
        scene: what components see of it: without test views and true depth.
    """

    title: str
    folder: Path | None
    identity: str
    iteration: int
    resumed: bool
    iterations: int
    pipeline: dict[str, Any]
    facts: dict[str, Any]
    scene: TrainingScene


@dataclass(frozen=True, eq=False)
class IterationDone:
    """An iteration is complete. Of several fields of Gaussians it tells of the first.

    Args:
        iteration: 1-based.
        seconds: spent training so far, in this run and before it was resumed.
        loss: the total loss before the optimizer's step.
        numbers: what the iteration recorded, by name: `photometric`, each regularizer that was due as
            `regularizers.NAME`, and what `Step.log` was given; those of further fields begin with
            `field1/`, `field2/`, ...
        gaussians: how many there are now.
        learning_rates: Adam's step size of each parameter group.
        view: the photograph that was learnt from.
        target: `[H, W, 3]`, what its render was compared with: the photograph, unless a sampler changed it.
        rendering: the render before the optimizer's step, without gradients: `rgb [H, W, 3]`, not
            clamped above, `depth [H, W]` and `alpha [H, W]`; of as many Gaussians as there were then.
        model: the Gaussians as they are now, to be read.
    """

    iteration: int
    seconds: float
    loss: float
    numbers: Mapping[str, float]
    gaussians: int
    learning_rates: Mapping[str, float]
    view: TrainingView
    target: Tensor
    rendering: Rendering
    model: GaussianReader

    def scalars(self) -> dict[str, float]:
        """All numbers for curves by name: `loss`, `numbers`, `gaussians`, `seconds`, `learning_rates/...`."""
        rates = {f"learning_rates/{name}": rate for name, rate in self.learning_rates.items()}
        counts = {"gaussians": float(self.gaussians), "seconds": self.seconds}
        return {"loss": self.loss, **self.numbers, **counts, **rates}


@dataclass(frozen=True, eq=False)
class ViewsScored:
    """Views were rendered and scored.

    Args:
        iteration: after which one.
        mean: each metric's mean over the views, by split, "test" or "train", and by metric; None
            where no view has it. While training goes on, only test views are scored.
        views: the scores by split, view and metric; None where the metric is not available.
    """

    iteration: int
    mean: Mapping[str, Mapping[str, float | None]]
    views: Mapping[str, Mapping[str, Mapping[str, float | None]]]

    def scalars(self) -> dict[str, float]:
        """The means that there are, by `test/psnr` and the like."""
        return {
            f"{split}/{metric}": value
            for split, means in self.mean.items()
            for metric, value in means.items()
            if value is not None
        }


@dataclass(frozen=True, eq=False)
class RunEnded:
    """Nothing more will be told.

    Args:
        iteration: the last one that is complete.
        finished: whether it is the pipeline's last; else the run was stopped, and may be resumed.
        results: what results.json holds; None where there is none: the run is kept in memory, was
            stopped or failed.
        error: what went wrong, for people; None if nothing did.
    """

    iteration: int
    finished: bool
    results: dict[str, Any] | None
    error: str | None
