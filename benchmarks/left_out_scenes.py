"""Scenes of `benchmarks.left_out`: without test views, whole, at half size or perturbed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from benchmarks.results_plan import CASES, temple
from registry import Scene, View

OVERRIDES = {f"{case.data}-{case.views}": case.overrides for case in (*CASES, temple(views=12))}
"""Overrides for a scene, by data set and number of training views."""
TURN = 0.7
"""Root mean square, in pixels, of the motion of a photograph's centre in `turned`."""
GAIN, TINT = 0.15, 0.05
"""Standard deviations of the logarithm of a photograph's brightness, and of each channel in addition."""


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


def turned(scene: Scene) -> Scene:
    """Rotate training cameras about their centres by one or two pixels, zero on average."""
    turns = torch.randn(len(scene.train), 3, generator=_draw(), dtype=torch.float64)
    turns = turns - turns.mean(dim=0)
    turns = turns * TURN / turns[:, :2].square().sum(dim=1).mean().sqrt()
    views = []
    for view, (x, y, z) in zip(scene.train, turns.tolist(), strict=True):
        cross = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
        motion = torch.eye(4, dtype=torch.float64)
        motion[:3, :3] = torch.linalg.matrix_exp(cross / view.camera.fx)
        camera = replace(view.camera, world_to_camera=motion @ view.camera.world_to_camera)
        views.append(replace(view, camera=camera))
    return replace(scene, train=tuple(views))


def exposed(scene: Scene) -> Scene:
    """Change brightness and tint of training photographs, zero on average; clamp to [0, 1]."""
    draw = _draw()
    count = len(scene.train)
    gains = GAIN * torch.randn(count, 1, generator=draw) + TINT * torch.randn(
        count, 3, generator=draw
    )
    gains = (gains - gains.mean(dim=0)).exp()
    views = tuple(
        replace(view, image=(gain * view.image).clamp(0, 1))
        for view, gain in zip(scene.train, gains, strict=True)
    )
    return replace(scene, train=views)


CHANGES: dict[str, Callable[[Scene], Scene]] = {
    "half": half,
    "turned": turned,
    "exposed": exposed,
}
"""Changes of a scene, by name."""


def _draw() -> torch.Generator:
    return torch.Generator().manual_seed(0)


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
