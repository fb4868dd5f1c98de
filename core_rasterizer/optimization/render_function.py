"""Joins a model's renders on the device to torch's graph."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..raster import Coverage, Images, RenderRequest

if TYPE_CHECKING:
    from .model import GaussianModel


class RenderFunction(torch.autograd.Function):
    """Forward: images of a model. Backward: gradients into the model's own, and one of the pose."""

    @staticmethod
    def forward(
        ctx: Any,
        anchor: Tensor,
        pose: Tensor,
        model: GaussianModel,
        request: RenderRequest,
        collect: tuple[bool, bool],
        detach: frozenset[str],
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Images, Coverage]:
        """Render.

        Args:
            anchor: requires a gradient, which makes torch call `backward`; it gets none.
            pose: `request.camera.world_to_camera`, whose gradient `backward` returns if it requires one.
            model: whose Gaussians are rendered.
            request: what to render.
            collect: whether `backward` collects screen gradients, and absolute ones.
            detach: parameters to whose gradient `backward` adds nothing.
        """
        images, lease = model.renderer.forward(model.block, request)
        ctx.set_materialize_grads(False)
        ctx.model, ctx.lease, ctx.images = model, lease, images
        ctx.collect, ctx.detach = collect, detach
        ctx.parameters = model.parameters
        return *images.outputs(), images, lease.frame.coverage(model.count)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        """Add to the model's gradients.

        Raises:
            GaussianError: Gaussians came or went since the forward pass.
        """
        ctx.model.check_unedited(ctx.parameters)
        d_rgb, d_depth, d_alpha, d_loss, *_ = gradients
        d_pose = ctx.model.add_gradients(
            ctx.lease.frame,
            ctx.images.gradients(d_rgb, d_depth, d_alpha, d_loss),
            ctx.collect,
            ctx.detach,
        )
        return None, d_pose, *(None,) * 4
