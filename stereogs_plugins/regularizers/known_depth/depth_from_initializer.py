"""`depth_from_initializer`: supervise depth with the initializer's depth maps (MVPGS, Xu et al. 2024).

The initializer must provide its depth maps (`PointCloud.maps`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry import HostDefaults, PluginError, Regularizer, Settings, Step
from registry.toolkit.images import at_size

if TYPE_CHECKING:
    from torch import Tensor


class DepthFromInitializer(Regularizer[Settings]):
    """mean |D - z| / z over the pixels with a known depth z; D is depth as blended, as in the paper."""

    host_defaults = HostDefaults(weight=0.1)

    def loss(self, step: Step) -> Tensor:
        """Return the loss for the iteration's view; 0 if its depth is unknown.

        Raises:
            PluginError: the initializer provides no depth maps.
        """
        if not step.maps:
            raise PluginError(
                "the initializer provides no depth maps",
                fix="use one that does, for example consistency_dense with `hand_on_depth: true`",
            )
        known = step.maps.get(step.view.name)
        if known is None:
            return step.rendering.depth.new_zeros(())
        rendered = step.rendering.depth
        valid = at_size(known.valid, *rendered.shape)
        if not valid.any():
            return rendered.new_zeros(())
        true = at_size(known.depth, *rendered.shape)[valid]
        return ((rendered[valid] - true) / true).abs().mean()
