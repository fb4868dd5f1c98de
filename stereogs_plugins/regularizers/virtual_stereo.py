"""`virtual_stereo`: what a camera beside the photograph's sees, moved back by the disparity, must be
the photograph (Binocular3DGS, Han et al. 2024).

The rendered depth z says how far a pixel moves when the camera does: by -f t / z for a shift t along the
camera's x axis. Gradients reach the Gaussians through both renders, the colours and the depth.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Register, Regularizer, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor

EDGE = 0.33
"""How much an edge of the photograph frees the disparity (the authors' code)."""


class VirtualStereoSettings(Settings):
    max_shift: float = Field(0.4, gt=0, allow_inf_nan=False)
    """World units; the shift is uniform between plus and minus this. The default is the authors', for
    COLMAP's units, where near content then moves by 10 pixels at most."""
    smoothness: float = Field(0.05, ge=0, allow_inf_nan=False)
    """Weight of the disparity's edge-aware smoothness beside the difference of colours."""


class VirtualStereo(Regularizer[VirtualStereoSettings]):
    """mean over all pixels of |warped - photograph|, where the warp has something, plus smoothness.

    The depth is z as blended, not divided by alpha. Where it is so small that the disparity would be
    wider than the image, a pixel counts for nothing.
    """

    def loss(self, step: Step) -> Tensor:
        """The term for this iteration's view."""
        import torch

        sample = step.sample
        drawn = float(torch.rand((), generator=self.generator))
        shift = self.settings.max_shift * (2 * drawn - 1)
        moves = -sample.camera.fx * shift
        depth = step.rendering.depth
        seen = depth.detach() * sample.camera.width > abs(moves)
        disparity = moves / depth.where(seen, torch.inf)
        shifted = step.render(sample.camera.shifted_right(shift)).rgb
        warped, inside = moved_back(shifted, disparity)
        difference = (warped - sample.target).abs() * (inside & seen)[:, :, None]
        smoothness = edge_aware_smoothness(disparity, sample.target, seen)
        return difference.mean() + self.settings.smoothness * smoothness


def moved_back(image: Tensor, disparity: Tensor) -> tuple[Tensor, Tensor]:
    """The image as the unshifted camera sees it.

    Args:
        image: `[H, W, 3]` of the shifted camera.
        disparity: `[H, W]` pixels: what pixel (u, v) of the unshifted camera shows is at (u + d, v).

    Returns:
        `[H, W, 3]`, bilinear in columns and 0 outside the image; and `[H, W]` bool, where it is inside.
    """
    import torch

    height, width = disparity.shape
    columns = torch.arange(width, dtype=disparity.dtype) + disparity
    inside = (columns >= 0) & (columns <= width - 1)
    position = columns.clamp(0, width - 1)
    left = position.detach().floor().clamp(0, max(width - 2, 0))
    part = (position - left)[:, :, None]
    rows = torch.arange(height)[:, None]
    right = (left.long() + 1).clamp(max=width - 1)
    first, second = image[rows, left.long()], image[rows, right]
    return (first + part * (second - first)) * inside[:, :, None], inside


def edge_aware_smoothness(disparity: Tensor, image: Tensor, seen: Tensor) -> Tensor:
    """mean |d'| exp(-0.33 |I'|) over columns plus the same over rows, central differences of pixels.

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
        edge = (0.5 * (i[2:] - i[:-2])).abs().mean(2)
        total = total + (slope * (-EDGE * edge).exp()).mean()
    return total


@hookimpl
def stereogs_register_regularizers(register: Register[VirtualStereo]) -> None:
    register("virtual_stereo", VirtualStereo)
