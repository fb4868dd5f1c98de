"""Renders and the backward pass within one iteration."""

from __future__ import annotations

import torch
from torch import Tensor

from core_rasterizer import Camera, ExplainedError, GaussianModel, Rendering

from ..contract.scene import Scene
from ..errors import PluginError


class StepRenderer:
    """What components call as `step.render`: another camera, the same Gaussians."""

    def __init__(self, model: GaussianModel, scene: Scene, sh_degree: int) -> None:
        self._model, self._scene, self._sh_degree = model, scene, sh_degree

    def __call__(self, camera: Camera, *, gradient: bool = True) -> Rendering:
        """Render `camera` on the scene's background, with the bands in use; modifiers do not apply.

        Args:
            gradient: let gradients flow to the Gaussians.
        """
        with torch.set_grad_enabled(gradient and torch.is_grad_enabled()):
            return self._model.render(
                camera, background=self._scene.background, sh_degree=self._sh_degree
            )


def backward(loss: Tensor, iteration: int) -> None:
    """The backward pass of the total loss.

    Raises:
        ExplainedError: a gradient with respect to a rendered image is not finite, though the loss is.
        PluginError: a regularizer's part of it failed; torch does not say whose.
    """
    try:
        loss.backward()
    except ExplainedError as error:
        error.where = f"{error.where}; iteration {iteration}"
        raise
    except Exception as error:
        raise PluginError(
            f"the backward pass of the loss failed: {type(error).__name__}: {error}",
            where=f"iteration {iteration}",
            fix="switch regularizers off one by one with --disable to find which one it is",
        ) from error
