"""Points of all views by kind, without those that other views duplicate or contradict."""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry.toolkit.progress import in_parallel

from ..layers import Layer, joined, surface
from ..visibility import (
    in_free_space,
    on_surface,
    onto_known_depth,
    source_indices,
    spread,
    visible,
)
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
    sources = _sources(views, bounds)

    def confirmed(index: int) -> Layer:
        layer = surface(views[index], views[index].confirmed > 0, stride)
        if not merge:
            return layer
        earlier = [views[k] for k in sources[index] if k < index]
        return layer.without(
            on_surface(layer.positions, [(o.camera, o.confirmed) for o in earlier])
        )

    def filled(view: ViewDepth) -> Layer:
        return surface(view, view.filled > 0, stride)

    return {
        "confirmed": joined(in_parallel(confirmed, range(len(views)))),
        "filled": joined(in_parallel(filled, views)),
    }


def back_layers(views: Sequence[ViewDepth], bounds: tuple[float, float]) -> Layer:
    """Back layers of all views, except where another view contradicts them or has a surface there."""
    sources = _sources(views, bounds)

    def remaining(index: int) -> Layer:
        layer = back_layer(views[index])
        others = [views[k] for k in sources[index]]
        layer = layer.without(
            in_free_space(layer.positions, [(o.camera, o.confirmed) for o in others])
        )
        return layer.without(on_surface(layer.positions, [(o.camera, o.completed) for o in others]))

    return joined(in_parallel(remaining, range(len(views))))


def margins(views: Sequence[ViewDepth], bounds: tuple[float, float]) -> Layer:
    """Margins of all views, outside the known depths of all others."""
    sources = _sources(views, bounds)

    def remaining(index: int) -> Layer:
        layer = margin(views[index])
        others = [views[k] for k in sources[index]]
        known = onto_known_depth(layer.positions, [(o.camera, o.completed) for o in others])
        return layer.without(known)

    return joined(in_parallel(remaining, range(len(views))))


def hidden(points: Floats, views: Sequence[ViewDepth]) -> Mask:
    """World points `[P, 3]` that no view can see."""
    return ~visible(points, [(view.camera, view.completed) for view in spread(views)])


def _sources(
    views: Sequence[ViewDepth], bounds: tuple[float, float]
) -> tuple[tuple[int, ...], ...]:
    return source_indices(tuple(view.camera for view in views), bounds)
