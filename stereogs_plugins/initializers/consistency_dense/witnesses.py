"""Which other views are asked about one view: a few, so that time grows with the number of views."""

from __future__ import annotations

from typing import TYPE_CHECKING

from core_rasterizer.matching import source_views

if TYPE_CHECKING:
    from collections.abc import Sequence

    from core_rasterizer import Camera

MOST_WITNESSES = 8
"""More cost time and confirm next to nothing."""


def witnesses(cameras: Sequence[Camera], index: int, bounds: tuple[float, float]) -> list[int]:
    """Other views, by triangulation angle and overlap, in their order.

    Args:
        index: of the view that they are asked about.
        bounds: (near, far) z-depth of the scene's content, world units.
    """
    return sorted(source_views(cameras, index, MOST_WITNESSES, bounds))
