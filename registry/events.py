"""Events of a run, passed to observers."""

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
    """A run begins or is resumed.

    Args:
        title: name of the run folder; of the pipeline for a run in memory.
        folder: existing folder for this observer's files, `observers/NAME` in the run folder; None for a
            run in memory, which must not leave files.
        identity: 32 hexadecimal digits, unique for each run and kept when it is resumed; empty for a run
            in memory.
        iteration: the last complete iteration.
        resumed: whether the run was stopped before; possibly at iteration 0.
        iterations: the total number of iterations.
        pipeline: the resolved pipeline as plain values, with all defaults.
        facts: scene, device, seed and others, as in results.json.
        scene: the scene without test views and true depth.
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
    """An iteration is complete. With several fields of Gaussians, data are of the first.

    Args:
        iteration: 1-based.
        seconds: training time so far, including before the run was resumed.
        loss: the total loss before the optimizer's step.
        numbers: values that the iteration recorded, by name: `photometric`, each regularizer that was due
            as `regularizers.NAME`, and those of `Step.log`; names of further fields begin with `field1/`,
            `field2/`, ...
        gaussians: the number of Gaussians now.
        learning_rates: Adam's step size of each parameter group.
        view: the training view.
        target: `Sample.target`, `[H, W, 3]`.
        rendering: the render before the optimizer's step, without gradients: `rgb [H, W, 3]`, not
            clamped above, `depth [H, W]` and `alpha [H, W]`.
        model: the Gaussians now, read only.
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
        """Return `loss`, `numbers`, `gaussians`, `seconds` and `learning_rates/...` by name."""
        rates = {f"learning_rates/{name}": rate for name, rate in self.learning_rates.items()}
        counts = {"gaussians": float(self.gaussians), "seconds": self.seconds}
        return {"loss": self.loss, **self.numbers, **counts, **rates}


@dataclass(frozen=True, eq=False)
class ViewsScored:
    """Views were rendered and scored.

    Args:
        iteration: the last complete iteration.
        mean: means over the views by split, "test" or "train", and metric; None if no view has a score.
            During training only test views are scored.
        views: the scores by split, view and metric; None if the metric is not available.
    """

    iteration: int
    mean: Mapping[str, Mapping[str, float | None]]
    views: Mapping[str, Mapping[str, Mapping[str, float | None]]]

    def scalars(self) -> dict[str, float]:
        """Return the means that are not None, by names such as `test/psnr`."""
        return {
            f"{split}/{metric}": value
            for split, means in self.mean.items()
            for metric, value in means.items()
            if value is not None
        }


@dataclass(frozen=True, eq=False)
class RunEnded:
    """A run has ended.

    Args:
        iteration: the last complete iteration.
        finished: whether it is the pipeline's last; otherwise the run can be resumed.
        results: content of results.json; None if the run is in memory, was stopped or failed.
        error: message of the error that ended the run, or None.
    """

    iteration: int
    finished: bool
    results: dict[str, Any] | None
    error: str | None
