"""Autograd functions whose gradients are stored on the device: renders, and losses on parameters.

Each takes an `anchor`, a scalar that requires a gradient, so that torch calls `backward`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..raster import Coverage, Images, Renderer, RenderRequest
from .gradients import DeferredPass
from .storage import GaussianStorage


class Activation(NamedTuple):
    """How a stored parameter becomes the quantity that it stands for."""

    stored: str
    """Name of the parameter."""
    activate: Callable[[Tensor], Tensor]
    """From stored to activated values."""
    slope: Callable[[Tensor], Tensor]
    """Derivative of `activate` at the stored values."""


ACTIVATED = {
    "opacities": Activation(
        # Avoids the cancellation of 1 - sigmoid(x) where a Gaussian is nearly opaque.
        "opacity_logits",
        torch.sigmoid,
        lambda x: torch.sigmoid(x) * torch.sigmoid(-x),
    ),
    "scales": Activation("log_scales", torch.exp, torch.exp),
}
"""Activated quantities by name."""


class ParameterFunction(torch.autograd.Function):
    """Forward: a copy of one parameter, stored or activated. Backward: adds to its gradient."""

    @staticmethod
    def forward(ctx: Any, anchor: Tensor, storage: GaussianStorage, name: str) -> Tensor:
        """Return the values of `name`, a parameter or a key of `ACTIVATED`."""
        ctx.storage, ctx.name, ctx.parameters = storage, name, storage.parameters
        if name not in ACTIVATED:
            return storage.read(name).clone()
        stored = storage.read(ACTIVATED[name].stored).clone()
        ctx.save_for_backward(stored)
        return ACTIVATED[name].activate(stored)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[None, None, None]:
        """Add to the storage's gradients.

        Raises:
            GaussianError: a gradient is not finite, or the Gaussians were edited since the forward pass.
        """
        storage: GaussianStorage = ctx.storage
        storage.check_unedited(ctx.parameters)
        stored_name = ctx.name
        if ctx.name in ACTIVATED:
            (stored,), stored_name = ctx.saved_tensors, ACTIVATED[ctx.name].stored
            gradient = gradient * ACTIVATED[ctx.name].slope(stored)
        first, _ = storage.rows_of(stored_name)
        rows = gradient.to(storage.dtype).reshape(storage.count, -1).T
        storage.gradients.add(ctx.name, first, rows)
        return None, None, None


class RenderFunction(torch.autograd.Function):
    """Forward: renders the Gaussians. Backward: adds to their gradients, returns that of the pose."""

    @staticmethod
    def forward(
        ctx: Any,
        anchor: Tensor,
        pose: Tensor,
        storage: GaussianStorage,
        renderer: Renderer,
        request: RenderRequest,
        collect: tuple[bool, bool],
        detach: frozenset[str],
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Images, Coverage]:
        """Render.

        Args:
            pose: `request.camera.world_to_camera`, for its gradient.
            collect: whether `backward` collects screen gradients, and absolute ones.
            detach: parameters whose gradient `backward` leaves unchanged.
        """
        images, lease = renderer.forward(storage.block, request)
        ctx.set_materialize_grads(False)
        ctx.storage, ctx.renderer, ctx.lease, ctx.images = storage, renderer, lease, images
        ctx.collect, ctx.detach, ctx.parameters = collect, detach, storage.parameters
        ctx.steps = storage.steps
        return *images.outputs(), images, lease.frame.coverage(storage.count)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *image_gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        """Add to the storage's gradients and statistics.

        Raises:
            GaussianError: the Gaussians were edited or stepped since the forward pass.
        """
        storage: GaussianStorage = ctx.storage
        storage.check_unedited(ctx.parameters)
        storage.check_not_stepped(ctx.steps)
        d_rgb, d_depth, d_alpha, d_loss, *_ = image_gradients
        images = ctx.images.gradients(d_rgb, d_depth, d_alpha, d_loss)
        renderer, frame, (collect, absolute) = ctx.renderer, ctx.lease.frame, ctx.collect
        statistics = storage.statistics.rows(absolute) if collect else None
        gradients, bands = storage.gradients, frame.request.bands
        gradients.store_deferred()  # it reads sums that this pass overwrites
        if frame.pairs and not frame.request.wants_pose_gradient:
            sums = renderer.begin_backward(frame, images, absolute=collect and absolute)
            gradients.defer(
                DeferredPass(renderer, ctx.lease, storage.block, sums, statistics, ctx.detach)
            )
            return (None,) * 7
        accumulate = gradients.begin_pass(bands)
        pose_gradient = renderer.backward(
            frame,
            storage.block,
            images,
            gradients.rows,
            accumulate=accumulate,
            statistics=statistics,
            detach=ctx.detach,
        )
        gradients.end_pass(bands)
        return None, pose_gradient, *(None,) * 5
