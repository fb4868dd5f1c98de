"""Parts of each `Step`: renders and learning rates."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from math import cos, pi

import torch
from torch import Tensor

from core_rasterizer import Camera, Model, Rendering

from ..contract.step import Render, Sample
from ..pipeline.training_settings import TrainingSettings


def step_renderer(model: Model, sample: Sample, *, gradients: bool = True) -> Render:
    """Return the implementation of `step.render`; see `registry.contract.step.Render`.

    Args:
        sample: gives the default background and SH degree.
        gradients: False for renders without gradients.
    """

    def render(
        camera: Camera,
        *,
        gradient: bool = True,
        background: Sequence[float] | None = None,
        opacity_scale: Tensor | None = None,
        detach: Collection[str] = (),
        sh_degree: float | None = None,
    ) -> Rendering:
        with torch.set_grad_enabled(gradient and gradients and torch.is_grad_enabled()):
            return model.render(
                camera,
                background=sample.background if background is None else background,
                sh_degree=int(sample.sh_degree if sh_degree is None else sh_degree),
                opacity_scale=opacity_scale,
                detach=detach,
            )

    return render


def learning_rates(iteration: int, settings: TrainingSettings, extent: float) -> dict[str, float]:
    """Return the learning rate of each parameter group of `core_rasterizer.Adam`.

    The rate of the means changes log-linearly from `position` to `position_final` (3DGS), the others along
    half a cosine to `final_share` of their value (Loshchilov and Hutter 2017, SGDR, eq. 5).

    Args:
        iteration: 1-based.
        extent: extent of the scene, world units; scales the rate of the means.
    """
    rates = settings.learning_rates
    progress = min(iteration / (rates.position_steps or settings.iterations), 1.0)
    if rates.position > 0 and rates.position_final > 0:
        position = rates.position * (rates.position_final / rates.position) ** progress
    else:  # no logarithm of zero: linear instead
        position = rates.position + (rates.position_final - rates.position) * progress
    half_cosine = (1 + cos(pi * iteration / settings.iterations)) / 2
    share = rates.final_share + (1 - rates.final_share) * half_cosine
    return {
        "means": position * extent,
        "sh_constant": share * rates.sh_constant,
        "sh_rest": share * rates.sh_rest,
        "opacity_logits": share * rates.opacity,
        "log_scales": share * rates.scale,
        "quaternions": share * rates.rotation,
    }
