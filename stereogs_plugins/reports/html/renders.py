"""Photographs and renders: a wipe between the two, the error, and the rendered depth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from PIL import Image

from registry.toolkit.drawing import RAMP, ViewPictures, depth_ends, ramp_picture, to_bytes
from registry.toolkit.progress import in_parallel
from registry.toolkit.web_page import choice, color_scale, figure, grid, image, note, wipe

from .scores import score

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from torch import Tensor

    from registry import Scene, View

MAX_VIEWS = 24
"""Limit of the views shown, for the size of the page."""
RENDERS = "renders"
_MAX_ERROR = 0.3
"""Error of the scale's last colour; colours are in [0, 1], errors averaged over the channels."""
_EXCLUDED = 0.5
"""Grey of pixels that a mask excludes, a colour that `RAMP` does not have."""
_LONGEST_SIDE = 1000


def renders(results: Mapping[str, Any], scene: Scene, folder: Path) -> str:
    """Return a part per view with a render, one shown at a time.

    The views are the test views, or the training views if there are none.
    """
    split, views = ("test", scene.test) if scene.test else ("train", scene.train)
    files = {view: ViewPictures.of(view.name, folder / RENDERS) for view in _some(views)}
    shown = [view for view, its in files.items() if its.render.is_file() and its.depth.is_file()]
    made = in_parallel(lambda view: _part(view, files[view], results, split), shown)
    parts = {view.name: part for view, part in zip(shown, made, strict=True)}
    text = f"{len(parts)} of {len(views)} photographs; the others are in the folder {RENDERS}."
    remark = note(text) if 0 < len(parts) < len(views) else ""
    return choice("photograph", parts) + remark


def _some(views: tuple[View, ...]) -> list[View]:
    """Return up to MAX_VIEWS views, evenly spaced."""
    count = min(len(views), MAX_VIEWS)
    return [views[index * len(views) // count] for index in range(count)]


def _part(view: View, files: ViewPictures, results: Mapping[str, Any], split: str) -> str:
    names = results["views"][split].get(view.name, {})
    scores = (f"{name} {score(results, split, name, view.name)}" for name in names)
    caption = ", ".join([view.name, *scores])
    photograph = image(_picture(view.image), "photograph", _LONGEST_SIDE)
    render = image(files.render, "render", _LONGEST_SIDE)
    compared = wipe(photograph, render, ("photograph", "render"))
    others = grid([_error(view, files), _depth(files)])
    return f'<div class="sides">{figure(caption, compared)}{others}</div>'


def _error(view: View, files: ViewPictures) -> str:
    with Image.open(files.render) as opened:
        rendered = torch.from_numpy(np.array(opened.convert("RGB"))).float() / 255
    if rendered.shape != view.image.shape:
        return ""
    error = ramp_picture((rendered - view.image).abs().mean(dim=2) / _MAX_ERROR)
    caption = "Error: mean difference of colours in [0, 1]"
    if view.mask is not None:
        error[~view.mask] = _EXCLUDED
        caption += "; grey: excluded by the mask"
    picture = image(_picture(error), "error", _LONGEST_SIDE)
    scale = color_scale(RAMP, ["0", f"{_MAX_ERROR / 2:g}", f"{_MAX_ERROR:g} and more"])
    return figure(caption, picture + scale)


def _depth(files: ViewPictures) -> str:
    ends = depth_ends(files.depth)
    scale = ""
    if ends is not None:
        near, far = ends
        middle = 2 / (1 / near + 1 / far)  # colours are linear in inverse depth
        scale = color_scale(RAMP, [f"{far:.4g} and more", f"{middle:.4g}", f"{near:.4g}"])
    picture = image(files.depth, "depth", _LONGEST_SIDE)
    return figure("Depth along the camera's axis, world units; black: empty", picture + scale)


def _picture(values: Tensor) -> Image.Image:
    return Image.fromarray(to_bytes(values))
