"""Renders within one iteration."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import torch
from torch import Tensor

from core_rasterizer import Camera, GaussianModel, Rendering

from ..contract.step import Sample


class StepRenderer:
    """The implementation of `step.render`; see `registry.contract.step.Render`.

    Args:
        sample: gives the default background and SH degree.
        gradients: False for renders without gradients.
    """

    def __init__(self, model: GaussianModel, sample: Sample, *, gradients: bool = True) -> None:
        self._model, self._sample, self._gradients = model, sample, gradients

    def __call__(
        self,
        camera: Camera,
        *,
        gradient: bool = True,
        background: Sequence[float] | None = None,
        opacity_scale: Tensor | None = None,
        detach: Collection[str] = (),
        sh_degree: float | None = None,
    ) -> Rendering:
        """Render `camera`."""
        wanted = gradient and self._gradients and torch.is_grad_enabled()
        with torch.set_grad_enabled(wanted):
            return self._model.render(
                camera,
                background=self._sample.background if background is None else background,
                sh_degree=int(self._sample.sh_degree if sh_degree is None else sh_degree),
                opacity_scale=opacity_scale,
                detach=detach,
            )
