"""Images of renders and depth maps, and comparisons with the photographs."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

from ...contract.scene import View
from ...system.files import replacing
from ..progress.parallel import in_parallel

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from torch import Tensor

    from core_rasterizer import Rendering

RAMP = (
    (0.10, 0.07, 0.25),
    (0.18, 0.30, 0.62),
    (0.13, 0.57, 0.55),
    (0.55, 0.78, 0.32),
    (1.00, 0.92, 0.45),
)
"""Color map from low to high (far to near), equally spaced, with increasing lightness."""
DRAWN = "Software"
"""PNG text that names the command that drew a picture, to tell it from a photograph."""
NEAREST, FARTHEST = "nearest depth", "farthest depth"
"""PNG texts of a depth image: z-depths of its lightest and its darkest color, world units."""
DEPTHS, COMPARISONS = "depth", "comparison"
"""Subfolders of the folder with the renders."""
_RAMP_STEPS = 1024
"""Steps of the color map; a step is less than one of 256 levels."""
_GAP = 4
"""White pixels between two images."""


def save_png(image: Tensor, path: Path, texts: Mapping[str, str] | None = None) -> None:
    """Write an image for `to_bytes` as an 8-bit PNG, with optional texts by keyword (tEXt chunks)."""
    from PIL import Image, PngImagePlugin

    info = PngImagePlugin.PngInfo()
    for keyword, text in (texts or {}).items():
        info.add_text(keyword, text)
    with replacing(path) as temporary:
        # Z_RLE finds repeats of the previous byte only. After PNG's filters, images have few others:
        # files are as small, and 25 % faster to write.
        pixels = Image.fromarray(to_bytes(image))
        pixels.save(temporary, "PNG", compress_type=zlib.Z_RLE, pnginfo=info)


def to_bytes(image: Tensor) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Clamp `[H, W, 3]` to [0, 1] and round it to uint8; uint8 stays as it is."""
    import torch

    if image.dtype == torch.uint8:
        return image.numpy()
    return image.detach().clamp(0, 1).mul_(255).round_().to(torch.uint8).numpy()


@dataclass(frozen=True)
class ViewPictures:
    """Paths of a view's render, its `depth_picture`, and photograph | render | depth side by side."""

    render: Path
    depth: Path
    comparison: Path

    @classmethod
    def of(cls, name: str, folder: Path) -> Self:
        """Return the paths for a view's name in a folder of renders."""
        file = f"{name}.png"
        return cls(folder / file, folder / DEPTHS / file, folder / COMPARISONS / file)


def save_view_pictures(
    rendering: Rendering, view: View, folder: Path, unit: float = 1.0, *, compared: bool = True
) -> ViewPictures:
    """Write a view's render, its depth, and photograph | render | depth side by side.

    Args:
        unit: of the rendering's depths, in units of the scene's files.
        compared: whether to write the third picture, which needs the photograph.
    """
    import torch

    files = ViewPictures.of(view.name, folder)
    # In bytes at once: floats of photographs of many megapixels need gigabytes.
    render, depth = (
        torch.from_numpy(to_bytes(image)) for image in (rendering.rgb, depth_picture(rendering))
    )
    for file in (files.depth, files.comparison):
        file.parent.mkdir(exist_ok=True)
    pictures = [
        (render, files.render, None),
        (depth, files.depth, _depth_texts(rendering, unit)),
    ]
    if compared:
        photograph = torch.from_numpy(to_bytes(view.image))
        pictures.append((side_by_side(photograph, render, depth), files.comparison, None))
    in_parallel(lambda picture: save_png(*picture), pictures)
    return files


def depth_picture(rendering: Rendering) -> Tensor:
    """Return depth in colors, `[H, W, 3]`: near is light, far is dark, empty pixels are black.

    Colors are linear in inverse depth between the 2nd and 98th percentiles of this image.
    """
    return nearness_picture(*_nearness(rendering))


def _nearness(rendering: Rendering) -> tuple[Tensor, Tensor]:
    """Return inverse depth, and True for pixels that are not empty."""
    alpha = rendering.alpha.detach()
    return alpha / rendering.depth.detach().clamp(min=1e-9), alpha > 0.5


def _depth_texts(rendering: Rendering, unit: float) -> dict[str, str]:
    """Return the texts `NEAREST` and `FARTHEST` of `depth_picture`; empty if all pixels are empty."""
    nearness, known = _nearness(rendering)
    if not known.any():
        return {}
    low, high = _ends(nearness, known)
    return {NEAREST: f"{unit / high:.6g}", FARTHEST: f"{unit / low:.6g}"}


def depth_ends(picture: Path) -> tuple[float, float] | None:
    """Return the z-depths of the lightest and the darkest color of a saved depth image, world units.

    None for an image without depth, or one written by an older version.
    """
    from PIL import Image

    with Image.open(picture) as opened:
        texts: Mapping[str, str] = getattr(opened, "text", {})
    try:
        return float(texts[NEAREST]), float(texts[FARTHEST])
    except (KeyError, ValueError):
        return None


def _ends(values: Tensor, known: Tensor) -> tuple[float, float]:
    """Return the 2nd and 98th percentiles of the known values."""
    import numpy as np

    low, high = np.quantile(values[known].numpy(), (0.02, 0.98))
    return float(low), float(high)


def nearness_picture(nearness: Tensor, known: Tensor) -> Tensor:
    """Return inverse depth or disparity in colors, `[H, W, 3]`: large is light, unknown is black.

    Colors are linear between the 2nd and 98th percentiles of the values that are `known`, `[H, W]` bool.
    """
    import torch

    if not known.any():
        return torch.zeros(*known.shape, 3)
    low, high = _ends(nearness, known)
    relative = torch.where(known, (nearness - low) / max(high - low, 1e-12), 0.0)
    return torch.where(known[..., None], ramp_picture(relative), 0.0)


def ramp_picture(values: Tensor) -> Tensor:
    """Convert `[H, W]`, clamped to [0, 1], to colors `[H, W, 3]` of `RAMP`."""
    import torch

    ramp = torch.nn.functional.interpolate(
        torch.tensor(RAMP).T[None], _RAMP_STEPS + 1, mode="linear", align_corners=True
    )[0].T
    return ramp.contiguous()[(values.clamp(0, 1) * _RAMP_STEPS).round().long()]


def side_by_side(*images: Tensor) -> Tensor:
    """Concatenate images for `to_bytes`, of one height and type, horizontally with white gaps."""
    import torch

    first = images[0]
    white = 255 if first.dtype == torch.uint8 else 1.0
    gap = first.new_full((first.shape[0], _GAP, 3), white)
    row: list[Tensor] = []
    for image in images:
        row += [image.detach(), gap]
    return torch.cat(row[:-1], dim=1)
