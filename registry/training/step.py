"""Parts of each `Step`: renders and learning rates."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from math import cos, pi

import torch
from torch import Tensor

from core_rasterizer import Camera, GaussianReader, Model, Rendering

from ..contract.rendered import Access
from ..contract.step import Render, Sample, Step
from ..pipeline.training_settings import TrainingSettings


def _contributions(step: Step) -> Tensor:
    from ..toolkit.views import gathered  # with the modules that few pipelines need

    camera = step.sample.camera
    _, light = gathered(step.model, [(camera, torch.zeros(camera.height, camera.width))])
    return light


def _normals(step: Step) -> Tensor:
    from ..toolkit.views import axis_normals

    return axis_normals(step.model, step.sample.camera)


OUTPUTS: Mapping[str, Callable[[Step], Tensor]] = {
    "normals": _normals,
    "contributions": _contributions,
}
"""How the outputs of `Step` that components declare are made, by name."""


class StepReader(GaussianReader):
    """The Gaussians of an iteration, without the statistics that a component does not declare."""

    def __init__(self, model: Model, access: Access) -> None:
        super().__init__(model)
        self._access = access

    def screen_gradient(self) -> Tensor:
        """Return the mean norm of the screen-space gradient; see `GaussianReader.screen_gradient`."""
        self._access.refuse_undeclared("screen_gradient")
        return super().screen_gradient()

    def absolute_screen_gradient(self) -> Tensor:
        """Return it without cancellation; see `GaussianReader.absolute_screen_gradient`."""
        self._access.refuse_undeclared("absolute_screen_gradient")
        return super().absolute_screen_gradient()


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
