"""Put a training together: from its first points, or from a checkpoint."""

from __future__ import annotations

from math import isqrt

from core_rasterizer import Gaussians, Model

from ..contract.scene import PointCloud, Scene
from ..pipeline.parts import Parts
from .checkpoint import Checkpoint
from .initial_model import initial_gaussians, new_model
from .prior_masks import with_prior_masks
from .trainer import Trainer


def assemble(
    parts: Parts, scene: Scene, points: PointCloud, gaussians: Gaussians | None = None
) -> Trainer:
    """Return the training of a pipeline before its first iteration.

    Args:
        parts: components of the pipeline; their device trains.
        scene: validated, in the frame of training.
        points: output of the initializer, checked (`check_initialization`).
        gaussians: made from the points (`initial_gaussians`); None makes them.

    Raises:
        GaussianError: a parameter is not finite.
    """
    settings = parts.pipeline.training
    if gaussians is None:
        gaussians = initial_gaussians(points, settings)
    model = new_model(gaussians, settings, parts.device)
    return Trainer(
        settings,
        parts,
        scene,
        model,
        points.maps,
        points.kinds,
        first_sh_degree=0 if points.sh is None else isqrt(points.sh.shape[1]) - 1,
    )


def restore(
    parts: Parts,
    scene: Scene,
    checkpoint: Checkpoint,
    model: Model | None = None,
    rates: float = 1.0,
) -> Trainer:
    """Return the training of a pipeline after a checkpoint; it continues to the same bits.

    Args:
        parts: as in `assemble`.
        scene: in the coordinates of its files.
        model: holds the checkpoint's Gaussians; None creates it.
        rates: factor of the learning rates.

    Raises:
        ExplainedError: the checkpoint does not match the parts, or a component cannot restore its state.
        Exception: tensors of the checkpoint do not fit; see `explain_misfit`.
    """
    settings = parts.pipeline.training
    if rates != 1.0:
        lower = settings.learning_rates.times(rates)
        settings = settings.model_copy(update={"learning_rates": lower})
    if model is None:
        model = new_model(Gaussians(**checkpoint.part("model")), settings, parts.device)
    framed = with_prior_masks(scene.in_frame(checkpoint.frame), parts)
    return Trainer(settings, parts, framed, model, checkpoint=checkpoint)
