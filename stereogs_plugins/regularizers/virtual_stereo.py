"""`virtual_stereo`: a render from a shifted camera, warped back by the rendered disparity, must match the
photograph (Binocular3DGS, Han et al. 2024).

For a shift t along the camera's x axis, a pixel with rendered depth z has the disparity -f t / z.
Gradients reach the Gaussians through both renders: the colours and the depth.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from registry import HostDefaults, Percent, Register, Regularizer, Settings, Step, hookimpl
from registry.toolkit.images import at_size

if TYPE_CHECKING:
    from torch import Tensor

MIN_ALPHA = 0.3
"""Alpha above which depth divided by alpha is used; dropout and decay leave less than 1 on surfaces."""
EDGE = 0.33
"""Decay of the smoothness with the photograph's gradient (the authors' code)."""


class VirtualStereoSettings(Settings):
    max_shift: float = Field(0.4, gt=0, allow_inf_nan=False)
    """The shift is uniform in [-max_shift, max_shift]. The default is the authors', for COLMAP's world
    units, where near content then moves by at most 10 pixels."""
    unit: Literal["world", "baseline"] = "world"
    """Unit of `max_shift`: that of the scene's files, or the distance to the nearest other camera."""
    depth: Literal["accumulated", "expected"] = "accumulated"
    """Rendered depth: as blended (the paper), which is too small where dropout or decay reduce alpha; or
    divided by alpha, at pixels with an alpha above 0.3 that show no background in a photograph with alpha."""
    smoothness: float = Field(0.05, ge=0, allow_inf_nan=False)
    """Weight of the edge-aware smoothness of the disparity, relative to the colour difference."""


class VirtualStereo(Regularizer[VirtualStereoSettings]):
    """mean |warped - photograph| over all pixels, 0 where the warp is undefined, plus smoothness.

    Pixels whose disparity would exceed the image width, or that do not train, are ignored.
    """

    host_defaults = HostDefaults(start=Percent(66.67))

    def loss(self, step: Step) -> Tensor:
        """Return the loss for this iteration's view."""
        import torch

        sample = step.sample
        drawn = float(torch.rand((), generator=self.generator))
        shift = self.settings.max_shift * self._unit(step) * (2 * drawn - 1)
        moves = -sample.camera.fx * shift
        depth, seen = self._depth(step)
        seen = seen & (depth.detach() * sample.camera.width > abs(moves))
        if sample.trained is not None:
            seen = seen & sample.trained
        disparity = moves / depth.where(seen, torch.inf)
        shifted = step.render(sample.camera.shifted_right(shift)).rgb
        warped, inside = moved_back(shifted, disparity)
        difference = (warped - sample.target).abs() * (inside & seen)[:, :, None]
        smoothness = edge_aware_smoothness(disparity, sample.target, seen)
        return difference.mean() + self.settings.smoothness * smoothness

    def _depth(self, step: Step) -> tuple[Tensor, Tensor]:
        """Depth `[H, W]` of the render, and the pixels `[H, W]` where it may be used."""
        import torch

        depth, alpha = step.rendering.depth, step.rendering.alpha
        if self.settings.depth == "accumulated":
            return depth, torch.ones(depth.shape, dtype=torch.bool)
        used = alpha.detach() > MIN_ALPHA
        if step.view.solid is not None:
            used &= at_size(step.view.solid, *depth.shape)
        return depth / alpha.where(used, 1.0), used

    def _unit(self, step: Step) -> float:
        """World units of a shift of 1; with a single training camera a baseline is the scene's extent."""
        if self.settings.unit == "world":
            return 1 / step.scene.frame.unit
        here = step.view.camera.center
        others = [view.camera.center for view in step.scene.train if view.name != step.view.name]
        return min((float((there - here).norm()) for there in others), default=step.extent)


def moved_back(image: Tensor, disparity: Tensor) -> tuple[Tensor, Tensor]:
    """Warp the image of the shifted camera to the unshifted camera.

    Args:
        image: `[H, W, 3]` of the shifted camera.
        disparity: `[H, W]` pixels: pixel (u, v) of the unshifted camera corresponds to (u + d, v).

    Returns:
        `[H, W, 3]`, bilinear in columns and 0 outside the image; and `[H, W]` bool, True inside the image.
    """
    import torch

    height, width = disparity.shape
    columns = torch.arange(width, dtype=disparity.dtype) + disparity
    inside = (columns >= 0) & (columns <= width - 1)
    position = columns.clamp(0, width - 1)
    left = position.detach().floor().clamp(0, max(width - 2, 0))
    part = (position - left)[:, :, None]
    # index_select and its gradient take two thirds of the time of image[rows, columns].
    index = (left.long() + width * torch.arange(height)[:, None]).flatten()
    pixels = image.reshape(height * width, -1)
    first, second = (
        pixels.index_select(0, at).view_as(image) for at in (index, index + min(1, width - 1))
    )
    return (first + part * (second - first)) * inside[:, :, None], inside


def edge_aware_smoothness(disparity: Tensor, image: Tensor, seen: Tensor) -> Tensor:
    """Return mean |d'| exp(-0.33 |I'|) over columns plus the same over rows, by central differences.

    Args:
        disparity: `[H, W]`.
        image: `[H, W, 3]`; |I'| is the mean over its channels.
        seen: `[H, W]` bool; a difference counts where both its pixels are seen.
    """
    total = disparity.new_zeros(())
    for axis in (0, 1):
        d, i, s = (x.transpose(0, axis) for x in (disparity, image, seen))
        if len(d) < 3:
            continue
        both = s[2:] & s[:-2]
        slope = (0.5 * (d[2:] - d[:-2])).abs() * both
        red, green, blue = (0.5 * (i[2:] - i[:-2])).abs().unbind(2)
        edge = (red + green + blue) / 3  # three times as fast as mean(2)
        total = total + (slope * (-EDGE * edge).exp()).mean()
    return total


@hookimpl
def stereogs_register_regularizers(register: Register[VirtualStereo]) -> None:
    register("virtual_stereo", VirtualStereo)
