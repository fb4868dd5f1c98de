"""All layers of all views, with what one view's points may not contradict in another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from .back_layer import back_layer
from .layers import Layer, joined, surface
from .margin import margin
from .other_views import covered, hides, overlooked
from .view_depth import ViewDepth

Item = TypeVar("Item")


def surfaces(views: Sequence[ViewDepth], *, stride: int, merge: bool) -> dict[str, Layer]:
    """The points "confirmed" and "filled" of all views.

    Args:
        merge: leave out confirmed points on surfaces that an earlier view confirms.
    """
    confirmed = [surface(view, view.confirmed > 0, stride) for view in views]
    if merge:
        cameras, depths = [view.camera for view in views], [view.confirmed for view in views]
        confirmed = [
            layer.without(covered(layer.positions, cameras[:index], depths[:index]))
            for index, layer in enumerate(confirmed)
        ]
    filled = [surface(view, view.filled > 0, stride) for view in views]
    return {"confirmed": joined(confirmed), "filled": joined(filled)}


def back_layers(views: Sequence[ViewDepth]) -> Layer:
    """The back layers of all views, as far as other views neither refute nor replace them."""
    layers = []
    for index, view in enumerate(views):
        layer, others = back_layer(view), all_but(views, index)
        cameras = [other.camera for other in others]
        layer = layer.without(hides(layer.positions, cameras, [o.confirmed for o in others]))
        layers.append(
            layer.without(covered(layer.positions, cameras, [o.completed for o in others]))
        )
    return joined(layers)


def margins(views: Sequence[ViewDepth]) -> Layer:
    """The margins of all views, outside the images of all others."""
    layers = []
    for index, view in enumerate(views):
        layer, others = margin(view), all_but(views, index)
        cameras, depths = [o.camera for o in others], [o.completed for o in others]
        layers.append(layer.without(overlooked(layer.positions, cameras, depths)))
    return joined(layers)


def all_but(items: Sequence[Item], index: int) -> list[Item]:
    """The items without the one at an index."""
    return [item for k, item in enumerate(items) if k != index]
