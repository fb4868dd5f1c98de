"""Trainable parameters of components: stepped, saved and restored by the host."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from core_rasterizer.finite import undefined_places

from ..contract.component import ParameterGroup
from ..errors import PluginError
from ..pipeline.blame import blame
from ..pipeline.parts import Part, Parts

_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


class ComponentParameters:
    """The parameters of all components of a pipeline, with one Adam per component.

    Args:
        parts: `parameters` of each component is called once.

    Raises:
        PluginError: a group has a tensor that is not a leaf with gradient, a repeated name, or a negative
            learning rate.
    """

    def __init__(self, parts: Parts) -> None:
        self._trained: list[tuple[Part, tuple[ParameterGroup, ...], torch.optim.Adam]] = []
        for part in parts:
            with part.at_work():
                groups = tuple(part.component.parameters())
                if groups:
                    check_groups(groups)
                    self._trained.append((part, groups, _adam(groups)))

    def zero_gradients(self) -> None:
        """Clear the gradients."""
        for _, _, optimizer in self._trained:
            optimizer.zero_grad(set_to_none=True)

    def check_gradients(self, iteration: int) -> None:
        """Refuse gradients that are not finite, before any step.

        Raises:
            PluginError: a gradient is not finite.
        """
        for part, groups, _ in self._trained:
            with blame(part.item, iteration):
                for group in groups:
                    for number, tensor in enumerate(group.tensors):
                        _refuse_undefined(tensor.grad, f"{group.name}, tensor {number}")

    def step(self) -> None:
        """Step each Adam; tensors without gradient do not change."""
        for _, _, optimizer in self._trained:
            optimizer.step()

    def state(self) -> dict[str, Tensor]:
        """Return values and moments, by slash-separated names."""
        state: dict[str, Tensor] = {}
        for part, groups, optimizer in self._trained:
            for group in groups:
                for index, tensor in enumerate(group.tensors):
                    name = f"{part.item.qualified_name}/{group.name}/{index}"
                    state[f"{name}/value"] = tensor.detach().clone()
                    moments = optimizer.state.get(tensor, {})
                    state |= {f"{name}/{key}": moments[key].clone() for key in moments}
        return state

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore the result of `state`."""
        for part, groups, optimizer in self._trained:
            for group in groups:
                for index, tensor in enumerate(group.tensors):
                    name = f"{part.item.qualified_name}/{group.name}/{index}"
                    with torch.no_grad():
                        tensor.copy_(state[f"{name}/value"])
                    moments = {key: state.get(f"{name}/{key}") for key in _MOMENTS}
                    if moments["step"] is not None:
                        optimizer.state[tensor] = {
                            key: value.clone()
                            for key, value in moments.items()
                            if value is not None
                        }


def _refuse_undefined(gradient: Tensor | None, name: str) -> None:
    if gradient is None:
        return
    undefined = undefined_places(gradient)
    if len(undefined):
        raise PluginError(
            f"the gradient of its parameters is not finite in {len(undefined)} values",
            where=f"{name}: {undefined[0].tolist()}",
            fix="look for a division by zero or a square root of zero where they are used",
        )


def check_groups(groups: Sequence[ParameterGroup]) -> None:
    """Refuse groups that cannot be trained.

    Raises:
        PluginError: see `ComponentParameters`.
    """
    names = [group.name for group in groups]
    if len(set(names)) < len(names):
        raise PluginError(f"two groups of parameters share a name: {', '.join(names)}")
    for group in groups:
        if not group.learning_rate >= 0:
            raise PluginError(f"the learning rate of {group.name!r} is {group.learning_rate}")
        for tensor in group.tensors:
            if not (tensor.is_leaf and tensor.requires_grad and tensor.is_floating_point()):
                raise PluginError(
                    f"the group {group.name!r} holds a tensor that cannot be trained",
                    fix="use torch leaves made with requires_grad=True",
                )


def _adam(groups: tuple[ParameterGroup, ...]) -> torch.optim.Adam:
    return torch.optim.Adam(
        [{"params": list(group.tensors), "lr": group.learning_rate} for group in groups]
    )
