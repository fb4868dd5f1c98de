"""Trainable parameters per training view, relative to their mean over the views."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ...contract.component import ParameterGroup

if TYPE_CHECKING:
    from torch import Tensor

    from ...contract.scene import TrainingScene, TrainingView


class ViewParameters:
    """A float64 tensor per training view, initially zero.

        self._exposure = ViewParameters(scene, (3,))
        brighter = rgb * self._exposure.of(view).exp()

    A change that all views share is ambiguous: the scene can compensate a motion of all cameras, the
    Gaussians a tint of all photographs. `of` therefore subtracts the mean over the views.
    """

    def __init__(self, scene: TrainingScene, shape: Sequence[int]) -> None:
        import torch

        self._values = {
            view.name: torch.zeros(*shape, dtype=torch.float64, requires_grad=True)
            for view in scene.train
        }

    def of(self, view: TrainingView) -> Tensor:
        """Return the view's tensor minus the mean over all views, with gradients.

        The mean is a constant in autograd, so that views that are not rendered get no gradient.
        """
        import torch

        mean = torch.stack([value.detach() for value in self._values.values()]).mean(dim=0)
        return self._values[view.name] - mean

    def group(self, name: str, learning_rate: float) -> ParameterGroup:
        """Return all tensors as a group for `Component.parameters`."""
        return ParameterGroup(name, tuple(self._values.values()), learning_rate)
