"""What metrics do to two images before they compare them, as a protocol says."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from ...contract.component import Settings

if TYPE_CHECKING:
    from torch import Tensor


class ImageMetricSettings(Settings):
    quantize: Literal["float", "png8"] = "float"
    """"float" compares colours as they are; "png8" first rounds both images to the 256 levels of a
    PNG file."""

    def prepared(self, image: Tensor) -> Tensor:
        """`image` `[H, W, 3]` in [0, 1] as it is to be compared, float64."""
        values = image.detach().double()
        if self.quantize == "png8":
            # Half a level is rounded up, as torchvision's `save_image` does for the published codes.
            values = (values.clamp(0, 1) * 255 + 0.5).floor() / 255
        return values


def white_outside(image: Tensor, mask: Tensor | None) -> Tensor:
    """The DTU protocol's image: white where the mask is False.

    Args:
        image: `[H, W, 3]`.
        mask: `[H, W]` bool, or None: the image stays as it is.
    """
    return image if mask is None else image.masked_fill(~mask[..., None], 1.0)
