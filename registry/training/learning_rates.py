"""Adam's step sizes in one iteration."""

from __future__ import annotations

from ..pipeline.training_settings import TrainingSettings


def learning_rates(iteration: int, settings: TrainingSettings, extent: float) -> dict[str, float]:
    """The learning rate of each parameter group of `core_rasterizer.Adam`.

    Only that of the means changes: log-linear from `position` to `position_final` (3DGS).

    Args:
        iteration: 1-based.
        extent: of the scene, world units; scales the rate of the means.
    """
    rates = settings.learning_rates
    steps = rates.position_steps or settings.iterations
    progress = min(iteration / steps, 1.0)
    if rates.position > 0 and rates.position_final > 0:
        position = rates.position * (rates.position_final / rates.position) ** progress
    else:  # a logarithm has no zero; go there in a straight line
        position = rates.position + (rates.position_final - rates.position) * progress
    return {
        "means": position * extent,
        "sh_constant": rates.sh_constant,
        "sh_rest": rates.sh_rest,
        "opacity_logits": rates.opacity,
        "log_scales": rates.scale,
        "quaternions": rates.rotation,
    }
