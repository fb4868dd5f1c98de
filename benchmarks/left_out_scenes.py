"""Scenes of `benchmarks.left_out`: without test views, whole or at half size."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor
from torch.nn.functional import avg_pool2d

from benchmarks.results_plan import CASES, temple
from registry import Scene, View

OVERRIDES = {f"{case.data}-{case.views}": case.overrides for case in (*CASES, temple(views=12))}
"""Overrides for a scene, by data set and number of training views."""


def thinned(scene: Scene) -> Scene:
    """Return the scene without its test views, tested on every third training view instead.

    Args:
        scene: Scene with at least two training views.
    """
    kept = tuple(view for index, view in enumerate(scene.train) if index % 3 != 1)
    tested = tuple(view for index, view in enumerate(scene.train) if index % 3 == 1)
    return replace(scene, train=kept, test=tested)


def half(scene: Scene) -> Scene:
    """Return the scene with photographs at half their size, for a quarter of the time."""
    return replace(
        scene, train=tuple(map(_halved, scene.train)), test=tuple(map(_halved, scene.test))
    )


def _halved(view: View) -> View:
    """Average four pixels into one; drop an odd last row or column."""
    camera = view.camera
    smaller = replace(
        camera,
        fx=camera.fx / 2,
        fy=camera.fy / 2,
        cx=camera.cx / 2,
        cy=camera.cy / 2,
        width=camera.width // 2,
        height=camera.height // 2,
    )
    image = _means_of_four(view.image)
    mask = None if view.mask is None else _means_of_four(view.mask[..., None].float())[..., 0] == 1
    alpha = None if view.alpha is None else _means_of_four(view.alpha[..., None])[..., 0]
    return View(view.name, smaller, image, mask, alpha)


def _means_of_four(image: Tensor) -> Tensor:
    return avg_pool2d(image.permute(2, 0, 1), 2).permute(1, 2, 0).contiguous()
