"""Facts about a loaded scene, for people."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from core_rasterizer import Camera
from registry import Scene, View
from registry.messages.suggestions import counted, listing
from registry.training.scene_facts import image_sizes, points_in_view

MAIN = 4
MOST_NAMED = 24
"""Longer lists of views show only the first and the last name; check.png shows all."""


def facts(scene: Scene) -> list[tuple[str, str]]:
    """Return the facts of a scene, each as label and text; the first `MAIN` are those that matter most."""
    views = (*scene.train, *scene.test)
    masked = sum(view.mask is not None for view in views)
    with_depth = sum(view.depth is not None for view in views)
    offset_x = _range(views, lambda camera: camera.cx - camera.width / 2)
    offset_y = _range(views, lambda camera: camera.cy - camera.height / 2)
    return [
        ("train", _names(scene.train)),
        ("test", _names(scene.test)),
        ("size", image_sizes(views)),
        ("points", _points(scene)),
        ("focal x", _range(views, lambda camera: camera.fx)),
        ("focal y", _range(views, lambda camera: camera.fy)),
        ("center off", f"x {offset_x}, y {offset_y}"),
        ("depth", f"{scene.bounds[0]:.4g} .. {scene.bounds[1]:.4g}"),
        ("masks", f"{masked} of {len(views)} views" if masked else "none"),
        ("true depth", f"{with_depth} of {len(views)} views" if with_depth else "none"),
        ("background", " ".join(f"{channel:g}" for channel in scene.background)),
    ]


def _names(views: Sequence[View]) -> str:
    if not views:
        return "none"
    names = [view.name for view in views]
    if len(names) > MOST_NAMED:
        names = [names[0], "...", names[-1]]
    return f"{counted(len(views), 'view')}: {listing(names)}"


def _range(views: Sequence[View], number: Callable[[Camera], float]) -> str:
    values = [number(view.camera) for view in views]
    low, high = min(values), max(values)
    return f"{low:.1f} px" if high - low < 0.05 else f"{low:.1f} .. {high:.1f} px"


def _points(scene: Scene) -> str:
    if scene.points is None or not len(scene.points):
        return "none"
    counts = [points_in_view(scene, view) for view in scene.train]
    few, most = min(counts), max(counts)
    in_each = f"{few:,}" if few == most else f"{few:,} to {most:,}"
    return f"{len(scene.points):,}; {in_each} in each training view"
