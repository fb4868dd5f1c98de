"""Renders and the backward pass within one iteration, guarded against gradients that are not finite."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from core_rasterizer import Camera, ExplainedError, GaussianModel, Rendering

from .errors import PluginError
from .scene import Scene


class StepRenderer:
    """What components call as `step.render`: another camera, the same Gaussians."""

    def __init__(self, model: GaussianModel, scene: Scene, sh_degree: int, iteration: int) -> None:
        self._model, self._scene = model, scene
        self._sh_degree, self._iteration = sh_degree, iteration

    def __call__(self, camera: Camera, *, gradient: bool = True) -> Rendering:
        """Render `camera` on the scene's background, with the bands in use; modifiers do not apply.

        Args:
            gradient: let gradients flow to the Gaussians.
        """
        with torch.set_grad_enabled(gradient and torch.is_grad_enabled()):
            rendering = self._model.render(
                camera, background=self._scene.background, sh_degree=self._sh_degree
            )
        watch_gradients(rendering, self._iteration)
        return rendering


def watch_gradients(rendering: Rendering, iteration: int) -> None:
    """Stop the backward pass before a gradient that is not finite reaches the Gaussians.

    A finite loss can have one: the square root at zero is the usual case.
    """

    def check(gradient: Tensor | None) -> None:
        # None: the loss does not look at this image. A sum is finite only if all its terms are, and
        # costs a tenth of asking each.
        if gradient is not None and not math.isfinite(float(gradient.sum())):
            raise PluginError(
                "the gradient of the loss is not finite, though the loss is",
                where=f"iteration {iteration}, with respect to a rendered image",
                fix="look for a square root, a logarithm or a division at zero in the regularizers",
            )

    for image in (rendering.rgb, rendering.depth, rendering.alpha):
        if image.requires_grad:
            image.register_hook(check)


def backward(loss: Tensor, iteration: int) -> None:
    """The backward pass of the total loss.

    Raises:
        PluginError: a regularizer's part of it failed; torch does not say whose.
    """
    try:
        loss.backward()
    except ExplainedError:
        raise
    except Exception as error:
        raise PluginError(
            f"the backward pass of the loss failed: {type(error).__name__}: {error}",
            where=f"iteration {iteration}",
            fix="switch regularizers off one by one with --disable to find which one it is",
        ) from error
