"""What a render returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from torch import Tensor

from .errors import ExplainedError

if TYPE_CHECKING:
    from .raster import Coverage, Images, Outputs


@dataclass(frozen=True, eq=False)
class Rendering:
    """One rendered view; three tensors on the CPU that take part in autograd.

    What the engine renders stays on its device: each image is fetched when it is first asked for, and
    `photometric_loss` fetches none.

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

    @classmethod
    def on_device(
        cls,
        rgb: Tensor,
        depth: Tensor,
        alpha: Tensor,
        loss: Tensor,
        images: Images,
        coverage: Coverage,
    ) -> Rendering:
        """A rendering of the engine's.

        Args:
            rgb, depth, alpha, loss: what autograd made of `Images.outputs`.
            images: where the device keeps them.
        """
        from .raster import Outputs

        outputs = Outputs(images, (rgb, depth, alpha, loss))
        rendering = cls.lazy(outputs.fetch, coverage)
        vars(rendering)["outputs"] = outputs
        return rendering

    @classmethod
    def lazy(cls, image: Callable[[str], Tensor], coverage: Coverage | None = None) -> Rendering:
        """A rendering whose images are made when they are first asked for.

        Args:
            image: makes "rgb", "depth" or "alpha".
        """
        rendering = object.__new__(cls)
        vars(rendering).update(coverage=coverage, image=image)
        return rendering

    if not TYPE_CHECKING:  # a type checker is to find misspelt names

        def __getattr__(self, name: str) -> Any:
            # Called only for what is not there yet.
            if name not in ("rgb", "depth", "alpha") or "image" not in vars(self):
                raise AttributeError(f"a Rendering has no {name!r}", name=name, obj=self)
            made = vars(self)[name] = vars(self)["image"](name)
            return made

    @property
    def fetched(self) -> dict[str, Tensor]:
        """The images that somebody has asked for, by name."""
        return {name: vars(self)[name] for name in ("rgb", "depth", "alpha") if name in vars(self)}

    @property
    def device_outputs(self) -> Outputs | None:
        """The images on the device that rendered them, in autograd; None if it was no device."""
        outputs: Outputs | None = vars(self).get("outputs")
        return outputs

    def detach(self) -> Rendering:
        """The same images without gradients; writing into them is writing into these."""
        return Rendering.lazy(lambda name: getattr(self, name).detach(), self.coverage)

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
