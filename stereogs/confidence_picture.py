"""Pictures of confidence: guessed parts of a render faded and hatched, and a scale of colours."""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry.toolkit.drawing import ramp_picture, to_bytes

if TYPE_CHECKING:
    from torch import Tensor

GUESSED = 0.5
"""Confidence below which a pixel counts as guessed."""
CONFIDENCE = "confidence"
"""Subfolder of the folder with the renders, and name of its file of numbers."""
_FADE = 0.55
"""Share of white in guessed parts."""
_PERIOD, _WIDTH = 10, 2
"""Pixels between hatching lines, and their width, in an image of 500 pixels."""
_LINE = (0.15, 0.15, 0.15)


def hatched(rgb: Tensor, confidence: Tensor, threshold: float = GUESSED) -> Tensor:
    """Return a render in which pixels of low confidence are pale and crossed by diagonal lines.

    Lightness and lines, not hues, tell them apart, so that it reads in print and for colour-blind people.

    Args:
        rgb: `[H, W, 3]` in [0, 1].
        confidence: `[H, W]` in [0, 1].
        threshold: confidence below which a pixel is guessed.
    """
    import torch

    height, width = confidence.shape
    scale = max(1, round(max(height, width) / 500))
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    lines = (rows + columns) % (_PERIOD * scale) < _WIDTH * scale
    size = 2 * scale + 3  # single pixels would show as noise
    smooth = torch.nn.functional.avg_pool2d(
        confidence[None], size, 1, size // 2, count_include_pad=False
    )[0]
    guessed = (smooth < threshold)[..., None]
    faded = torch.where(guessed, rgb * (1 - _FADE) + _FADE, rgb)
    return torch.where(guessed & lines[..., None], rgb.new_tensor(_LINE), faded)


def with_scale(confidence: Tensor) -> Tensor:
    """Return confidence in colours of `RAMP`, dark is guessed and light is sure, above a labelled scale.

    Args:
        confidence: `[H, W]` in [0, 1].

    Returns:
        `[H + B, W, 3]` with a bar of B rows below.
    """
    import numpy as np
    import torch
    from PIL import Image, ImageDraw

    width = confidence.shape[1]
    bar = 32
    scale = ramp_picture(torch.linspace(0, 1, width)[None].repeat(bar // 2, 1))
    picture = Image.fromarray(to_bytes(torch.cat([scale, torch.ones(bar - bar // 2, width, 3)])))
    draw = ImageDraw.Draw(picture)
    labels = (("guessed 0", 2, "lt"), ("0.5", width / 2, "mt"), ("1 sure", width - 2, "rt"))
    for text, place, anchor in labels:
        draw.text((place, bar // 2 + 2), text, fill=(0, 0, 0), anchor=anchor)
    legend = torch.from_numpy(np.array(picture)).float() / 255
    return torch.cat([ramp_picture(confidence), legend])
