"""Points of all views by kind, without those that other views duplicate or contradict."""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry.photos import in_parallel

from ..layers import Layer, joined, surface
from ..visibility import in_free_space, on_surface, onto_known_depth, source_indices, visible
from .back_layer import back_layer
from .margin import margin

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..projection import Floats, Mask
    from ..view_depth import ViewDepth


def surfaces(
    views: Sequence[ViewDepth], bounds: tuple[float, float], *, stride: int, merge: bool
) -> dict[str, Layer]:
    """The points "confirmed" and "filled" of all views.

    Args:
        bounds: (near, far) z-depth of the scene's content, world units.
        merge: drop confirmed points on surfaces that an earlier view confirms.
    """

    def confirmed(index: int) -> Layer:
        layer = surface(views[index], views[index].confirmed > 0, stride)
        if not merge:
            return layer
        earlier = [views[k] for k in _source_indices(views, index, bounds) if k < index]
        cameras, depths = [o.camera for o in earlier], [o.confirmed for o in earlier]
        return layer.without(on_surface(layer.positions, cameras, depths))

    def filled(view: ViewDepth) -> Layer:
        return surface(view, view.filled > 0, stride)

    return {
        "confirmed": joined(in_parallel(confirmed, range(len(views)))),
        "filled": joined(in_parallel(filled, views)),
    }


def back_layers(views: Sequence[ViewDepth], bounds: tuple[float, float]) -> Layer:
    """Back layers of all views, except where another view contradicts them or has a surface there."""

    def remaining(index: int) -> Layer:
        layer = back_layer(views[index])
        others = [views[k] for k in _source_indices(views, index, bounds)]
        cameras = [other.camera for other in others]
        layer = layer.without(
            in_free_space(layer.positions, cameras, [o.confirmed for o in others])
        )
        return layer.without(on_surface(layer.positions, cameras, [o.completed for o in others]))

    return joined(in_parallel(remaining, range(len(views))))


def margins(views: Sequence[ViewDepth], bounds: tuple[float, float]) -> Layer:
    """Margins of all views, outside the known depths of all others."""

    def remaining(index: int) -> Layer:
        layer = margin(views[index])
        others = [views[k] for k in _source_indices(views, index, bounds)]
        cameras, depths = [o.camera for o in others], [o.completed for o in others]
        return layer.without(onto_known_depth(layer.positions, cameras, depths))

    return joined(in_parallel(remaining, range(len(views))))


def hidden(points: Floats, views: Sequence[ViewDepth]) -> Mask:
    """World points `[P, 3]` that no view can see."""
    return ~visible(points, [view.camera for view in views], [view.completed for view in views])


def _source_indices(
    views: Sequence[ViewDepth], index: int, bounds: tuple[float, float]
) -> list[int]:
    return source_indices([view.camera for view in views], index, bounds)
