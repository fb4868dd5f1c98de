"""All layers of all views, with what one view's points may not contradict in another."""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry.toolkit.photos import in_parallel

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

    def confirmed(index: int) -> Layer:
        layer = surface(views[index], views[index].confirmed > 0, stride)
        if not merge:
            return layer
        earlier = [views[k] for k in _witnesses(views, index, bounds) if k < index]
        cameras, depths = [o.camera for o in earlier], [o.confirmed for o in earlier]
        return layer.without(covered(layer.positions, cameras, depths))

    def filled(view: ViewDepth) -> Layer:
        return surface(view, view.filled > 0, stride)

    return {
        "confirmed": joined(in_parallel(confirmed, range(len(views)))),
        "filled": joined(in_parallel(filled, views)),
    }


def back_layers(views: Sequence[ViewDepth], bounds: tuple[float, float]) -> Layer:
    """The back layers of all views, as far as other views neither refute nor replace them."""

    def replacing(index: int) -> Layer:
        layer = back_layer(views[index])
        others = [views[k] for k in _witnesses(views, index, bounds)]
        cameras = [other.camera for other in others]
        layer = layer.without(hides(layer.positions, cameras, [o.confirmed for o in others]))
        return layer.without(covered(layer.positions, cameras, [o.completed for o in others]))

    return joined(in_parallel(replacing, range(len(views))))


def margins(views: Sequence[ViewDepth], bounds: tuple[float, float]) -> Layer:
    """The margins of all views, outside the images of all others."""

    def outside(index: int) -> Layer:
        layer = margin(views[index])
        others = [views[k] for k in _witnesses(views, index, bounds)]
        cameras, depths = [o.camera for o in others], [o.completed for o in others]
        return layer.without(overlooked(layer.positions, cameras, depths))

    return joined(in_parallel(outside, range(len(views))))


def _witnesses(views: Sequence[ViewDepth], index: int, bounds: tuple[float, float]) -> list[int]:
    return witnesses([view.camera for view in views], index, bounds)
