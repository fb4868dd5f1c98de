"""All layers of all views, with what one view's points may not contradict in another."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .completing.back_layer import back_layer
from .completing.margin import margin
from .layers import Layer, joined, surface
from .other_views import covered, hides, overlooked
from .witnesses import witnesses

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .view_depth import ViewDepth


def surfaces(
    views: Sequence[ViewDepth], bounds: tuple[float, float], *, stride: int, merge: bool
) -> dict[str, Layer]:
    """The points "confirmed" and "filled" of all views.

    Args:
        bounds: (near, far) z-depth of the scene's content, world units.
        merge: leave out confirmed points on surfaces that an earlier view confirms.
    """
    confirmed = [surface(view, view.confirmed > 0, stride) for view in views]
    if merge:
        for index, layer in enumerate(confirmed):
            earlier = [views[k] for k in _witnesses(views, index, bounds) if k < index]
            cameras, depths = [o.camera for o in earlier], [o.confirmed for o in earlier]
            confirmed[index] = layer.without(covered(layer.positions, cameras, depths))
    filled = [surface(view, view.filled > 0, stride) for view in views]
    return {"confirmed": joined(confirmed), "filled": joined(filled)}


def back_layers(views: Sequence[ViewDepth], bounds: tuple[float, float]) -> Layer:
    """The back layers of all views, as far as other views neither refute nor replace them."""
    layers = []
    for index, view in enumerate(views):
        layer = back_layer(view)
        others = [views[k] for k in _witnesses(views, index, bounds)]
        cameras = [other.camera for other in others]
        layer = layer.without(hides(layer.positions, cameras, [o.confirmed for o in others]))
        layers.append(
            layer.without(covered(layer.positions, cameras, [o.completed for o in others]))
        )
    return joined(layers)


def margins(views: Sequence[ViewDepth], bounds: tuple[float, float]) -> Layer:
    """The margins of all views, outside the images of all others."""
    layers = []
    for index, view in enumerate(views):
        layer = margin(view)
        others = [views[k] for k in _witnesses(views, index, bounds)]
        cameras, depths = [o.camera for o in others], [o.completed for o in others]
        layers.append(layer.without(overlooked(layer.positions, cameras, depths)))
    return joined(layers)


def _witnesses(views: Sequence[ViewDepth], index: int, bounds: tuple[float, float]) -> list[int]:
    return witnesses([view.camera for view in views], index, bounds)
