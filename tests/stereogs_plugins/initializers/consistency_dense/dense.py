"""The initializer on a scene whose depths are known."""

from __future__ import annotations

from typing import Any

from registry import PointCloud, Scene
from stereogs_plugins.initializers.consistency_dense import ConsistencyDense
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.initializers.depth_scenes import as_it_is, prior_of, true_depth

COMPLETE = {"fill": True, "back_layer": True, "margin": True, "merge": True}
"""Settings that switch on all of the completion."""


def dense(scene: Scene, depth_of: Any = true_depth, **settings: Any) -> PointCloud:
    return build(ConsistencyDense, **settings).initialize(
        as_it_is(scene), {"depth": prior_of(depth_of)}
    )
