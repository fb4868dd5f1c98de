"""Learning rates of one iteration."""

from __future__ import annotations

from math import cos, pi

from ..pipeline.training_settings import TrainingSettings


def learning_rates(iteration: int, settings: TrainingSettings, extent: float) -> dict[str, float]:
    """Return the learning rate of each parameter group of `core_rasterizer.Adam`.

    The rate of the means changes log-linearly from `position` to `position_final` (3DGS), the others along
    half a cosine to `final_share` of their value (Loshchilov and Hutter 2017, SGDR, eq. 5).

    Args:
        iteration: 1-based.
        extent: extent of the scene, world units; scales the rate of the means.
    """
    rates = settings.learning_rates
    steps = rates.position_steps or settings.iterations
    progress = min(iteration / steps, 1.0)
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
