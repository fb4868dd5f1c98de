"""Numbers that each training view has of its own, trained relative to their mean over the views."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ...contract.component import ParameterGroup

if TYPE_CHECKING:
    from torch import Tensor

    from ...contract.scene import TrainingScene, TrainingView


class ViewParameters:
    """A float64 tensor for each training view, all zero at the start.

    What all views share is no property of a view: a motion of all cameras can be undone by one of the
    scene, a tint of all photographs by one of the Gaussians. `of` therefore takes the mean over the views
    away, so that the numbers of the views add up to zero.

    Args:
        scene: whose training views they are; at least one.
        shape: of each view's tensor.
    """

    def __init__(self, scene: TrainingScene, shape: Sequence[int]) -> None:
        import torch

        self._values = {
            view.name: torch.zeros(*shape, dtype=torch.float64, requires_grad=True)
            for view in scene.train
        }

    def of(self, view: TrainingView) -> Tensor:
        """The view's own numbers minus the mean of all views', in autograd.

        The mean counts as a constant: a view that is not looked at gets no gradient, and its tensor
        no step.
        """
        import torch

        mean = torch.stack([value.detach() for value in self._values.values()]).mean(dim=0)
        return self._values[view.name] - mean

    def group(self, name: str, learning_rate: float) -> ParameterGroup:
        """All of them, for `Component.parameters`."""
        return ParameterGroup(name, tuple(self._values.values()), learning_rate)
