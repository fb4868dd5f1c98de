"""One training iteration, as components see it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from core_rasterizer import GaussianModel, Rendering

    from .prior import Prior
    from .scene import Scene, View


@dataclass
class Step:
    """One training iteration, as the components see it.

    Args:
        iteration: 1-based.
        iterations: the total number of iterations.
        scene: the whole scene.
        view: the training view of this iteration.
        rendering: the render of that view (`rgb [H, W, 3]`, `depth [H, W]`, `alpha [H, W]`; autograd).
            None while modifiers are asked, which is before the render.
        model: the Gaussians; read what is needed with `model.read(name)`, after the backward pass
            also `model.gradient(name)`.
        extent: the scene's extent in world units (`Scene.extent`).
        priors: the pipeline's prior models by name.
        render: `render(camera, *, gradient=True)` renders another camera at the current parameters,
            without modifiers, on the scene's background; gradients flow if `gradient`.
        log: records a number under a name in the run's metrics.
    """

    iteration: int
    iterations: int
    scene: Scene
    view: View
    rendering: Rendering | None
    model: GaussianModel
    extent: float
    priors: Mapping[str, Prior[Any]]
    render: Callable[..., Rendering]
    log: Callable[[str, float], None]
