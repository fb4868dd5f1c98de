"""What a render returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from torch import Tensor

from .errors import ExplainedError

if TYPE_CHECKING:
    from .raster import Coverage


@dataclass(frozen=True, eq=False)
class Rendering:
    """One rendered view; three tensors on the CPU that take part in autograd.

    With alpha_i the opacity that Gaussian i has at a pixel and T_i the light that the Gaussians in
    front of it let through, each field sums over the Gaussians in order of depth.

    Args:
        rgb: `[H, W, 3]`, the sum of colour * alpha_i * T_i, plus the background times what light is
            left. Linear in the colours, at least 0, not clamped above.
        depth: `[H, W]`, the sum of z_i * alpha_i * T_i in world units, where z is the distance along
            the camera's axis. It is not divided by `alpha`: 0 where nothing was hit.
        alpha: `[H, W]`, the sum of alpha_i * T_i, from 0 (nothing hit) to 1 (opaque).
        coverage: where `visible` is read from; None if it was not the engine that rendered this.
    """

    rgb: Tensor
    depth: Tensor
    alpha: Tensor
    coverage: Coverage | None = field(default=None, repr=False)

    @property
    def visible(self) -> Tensor:
        """Which Gaussians reached the image, bool `[N]`.

        Those that are not culled, and whose ellipse of alpha >= 1/255 reaches a pixel's centre in a
        tile of the image; whether nearer Gaussians hide them does not matter. Read from the device
        when asked for, and right for as long as this object lives, whatever is rendered after it.

        Raises:
            ExplainedError: this was not rendered by the engine but put together by hand.
        """
        if self.coverage is None:
            raise ExplainedError(
                "which Gaussians this rendering shows is not known",
                where="Rendering.visible",
                fix="ask a rendering that `render` or `rasterize` returned",
            )
        return self.coverage.visible()
