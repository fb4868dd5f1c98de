"""`depth_from_initializer`: rendered depth beside what the initializer knows (MVPGS, Xu et al. 2024).

The initializer must hand its depth maps on (`PointCloud.maps`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry import PluginError, Regularizer, Settings, Step
from registry.toolkit.networks.image_fitting import at_size

if TYPE_CHECKING:
    from torch import Tensor


class DepthFromInitializer(Regularizer[Settings]):
    """mean |D - z| / z over the pixels whose depth z is known; D is depth as blended, as in the paper."""

    def loss(self, step: Step) -> Tensor:
        """The term for the view at hand; 0 where nothing of it is known.

        Raises:
            PluginError: the initializer handed no depth maps on.
        """
        if not step.maps:
            raise PluginError(
                "the initializer has handed no depth maps on",
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
