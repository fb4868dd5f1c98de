"""Scenes of `benchmarks.next_views`: a pool of photographs to choose from, and test views, all small."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

from benchmarks.left_out_scenes import half
from benchmarks.trainings import DATA
from core_rasterizer import Camera
from registry import Scene, View
from registry.toolkit.photos import evenly_spaced
from stereogs.session import build_pipeline, load_scene

PIPELINE = "weightfree_quick"
START = 3
"""Photographs at the start, evenly spaced in the order of the capture."""
MAX_IN_POOL, MAX_TESTED = 20, 12
_TEST_EVERY = 3
"""On DTU, whose protocol has nine training views, every third of its 34 usable views tests."""


@dataclass(frozen=True)
class Source:
    """Where a scene comes from.

    Args:
        override: the scene of the pipeline, as for `--set`; the folder is named like the data set.
        halvings: how often the photographs are halved.
    """

    loader: str
    settings: str = ""
    halvings: int = 1


_ALL = "train_views: 0"
SOURCES = {
    "llff_fern": Source("llff", _ALL),
    "llff_flower": Source("llff", _ALL),
    "llff_fortress": Source("llff", _ALL),
    "llff_room": Source("llff", _ALL),
    "dtu_scan24": Source("dtu", "train_views: 9"),
    "dtu_scan65": Source("dtu", "train_views: 9"),
    "dtu_scan114": Source("dtu", "train_views: 9"),
    "blender_lego": Source("blender", "train_ids: null"),
    "mip360_bonsai": Source(
        "llff", "train_views: 48, images: images_800, bounds: estimate", halvings=2
    ),
}
"""Sources by data set."""
SCENES = tuple(SOURCES)


@dataclass(frozen=True, eq=False)
class PoolScene:
    """A scene of which a few photographs of the pool are chosen to train on.

    Args:
        whole: its training views are the pool, in the order of the capture.
    """

    name: str
    whole: Scene

    @property
    def cameras(self) -> list[Camera]:
        return [view.camera for view in self.whole.train]

    @property
    def start(self) -> tuple[int, ...]:
        """Indices of the first photographs."""
        return tuple(evenly_spaced(list(range(len(self.whole.train))), START))

    def of(self, chosen: Sequence[int]) -> Scene:
        """Return the scene that trains on some photographs."""
        train = tuple(self.whole.train[k] for k in sorted(chosen))
        return replace(self.whole, train=train)


@cache
def pool_scene(name: str) -> PoolScene:
    """Load a scene; nothing of its structure from motion is used, because all photographs contributed."""
    source = SOURCES[name]
    folder = f"use: {source.loader}, path: '${{{DATA}}}/{name}'"
    settings = f", {source.settings}" if source.settings else ""
    scene = load_scene(build_pipeline(PIPELINE, [f"scene={{{folder}{settings}}}"]))
    train, test = scene.train, scene.test
    if source.loader == "dtu":
        train, test = _resplit((*train, *test))
    train, test = _at_most(MAX_IN_POOL, train), _at_most(MAX_TESTED, test)
    scene = replace(scene, train=train, test=test, points=None)
    for _ in range(source.halvings):
        scene = half(scene)
    return PoolScene(name, scene)


def _resplit(views: Sequence[View]) -> tuple[tuple[View, ...], tuple[View, ...]]:
    ordered = sorted(views, key=lambda view: view.name)
    pool = tuple(view for k, view in enumerate(ordered) if k % _TEST_EVERY)
    return pool, tuple(ordered[::_TEST_EVERY])


def _at_most(count: int, views: Sequence[View]) -> tuple[View, ...]:
    return tuple(views[k] for k in evenly_spaced(list(range(len(views))), min(count, len(views))))
