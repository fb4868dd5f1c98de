"""The result of a render."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from torch import Tensor

from .errors import ExplainedError

if TYPE_CHECKING:
    from .raster import Images, Outputs


class Coverage(Protocol):
    """Knows which Gaussians of a render reached the image."""

    def visible(self) -> Tensor:
        """Bool `[N]`; see `Rendering.visible`."""


@dataclass(frozen=True, eq=False)
class Rendering:
    """One rendered view: three tensors on the CPU that take part in autograd.

    Renders of the engine stay on the device: each image is copied on first access, and
    `photometric_loss` copies none.

    With alpha_i the opacity of Gaussian i at a pixel and T_i the transmittance of the Gaussians in front
    of it, each image is a sum over the Gaussians.

    Args:
        rgb: `[H, W, 3]`, the sum of colour * alpha_i * T_i, plus the background times the remaining
            transmittance. Linear in the colours, >= 0, not clamped above.
        depth: `[H, W]`, the sum of z_i * alpha_i * T_i in world units, with z_i the z-depth. Not divided
            by `alpha`: 0 where nothing was hit.
        alpha: `[H, W]`, the sum of alpha_i * T_i, from 0 (nothing hit) to 1 (opaque).
        coverage: source of `visible`; None if the engine did not render this.
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
        losses: Tensor,
        images: Images,
        coverage: Coverage,
    ) -> Rendering:
        """A rendering by the engine.

        Args:
            rgb, depth, alpha, losses: `Images.outputs` as returned by the autograd function.
            images: on the device.
        """
        from .raster import Outputs

        outputs = Outputs(images, (rgb, depth, alpha, losses))
        rendering = cls.lazy(outputs.fetch, coverage)
        vars(rendering)["outputs"] = outputs
        return rendering

    @classmethod
    def lazy(cls, image: Callable[[str], Tensor], coverage: Coverage | None = None) -> Rendering:
        """A rendering whose images are computed on first access.

        Args:
            image: returns "rgb", "depth" or "alpha".
        """
        rendering = object.__new__(cls)
        vars(rendering).update(coverage=coverage, image=image)
        return rendering

    def watch(self) -> Callable[[], list[str]]:
        """Keep the sum of each image that is accessed from now on.

        Returns:
            A function that names the images whose sum has changed. So writes past torch are found, for
            example through numpy; they reach the memory of a device that shares it.
        """
        # Other engines may have made the images already; these are watched from now on. `summed` must not
        # refer to this rendering: such a cycle would keep its memory.
        image = vars(self).get("image") or self.fetched.__getitem__
        sums = dict[str, tuple[Tensor, Tensor]]()

        def summed(name: str) -> Tensor:
            made: Tensor = image(name)
            sums[name] = made.detach(), made.detach().sum()
            return made

        def changed() -> list[str]:
            pairs = {name: (now.sum(), before) for name, (now, before) in sums.items()}
            return [n for n, p in pairs.items() if not p[0].isclose(*p[1:], 0, 0, equal_nan=True)]

        for name in self.fetched if "image" not in vars(self) else ():
            summed(name)
        vars(self)["image"] = summed
        return changed

    if not TYPE_CHECKING:  # so that type checkers find misspelt names

        def __getattr__(self, name: str) -> Any:
            # Called only for attributes that are not set yet.
            if name not in ("rgb", "depth", "alpha") or "image" not in vars(self):
                raise AttributeError(f"a Rendering has no {name!r}", name=name, obj=self)
            made = vars(self)[name] = vars(self)["image"](name)
            return made

    @property
    def fetched(self) -> dict[str, Tensor]:
        """The images that have been accessed, by name."""
        known = vars(self)
        return {name: known[name] for name in ("rgb", "depth", "alpha") if name in known}

    @property
    def device_outputs(self) -> Outputs | None:
        """The images on the device, in autograd; None if the engine did not render this."""
        outputs: Outputs | None = vars(self).get("outputs")
        return outputs

    def detach(self) -> Rendering:
        """The same images without gradients; they share memory."""
        return Rendering.lazy(lambda name: getattr(self, name).detach(), self.coverage)

    @property
    def visible(self) -> Tensor:
        """Which Gaussians reached the image, bool `[N]`.

        True if not culled and the ellipse of alpha >= 1/255 contains a pixel centre of the image, even
        if nearer Gaussians hide it. Copied from the device on access; later renders do not change it.

        Raises:
            ExplainedError: the engine did not render this.
        """
        if self.coverage is None:
            raise ExplainedError(
                "the visible Gaussians of this rendering are unknown",
                where="Rendering.visible",
                fix="use a rendering returned by `render` or `rasterize`",
            )
        return self.coverage.visible()
