"""Adam on the device: one pass over parameters, gradients and moments."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from ..device import DeviceArray
from ..errors import ExplainedError, GaussianError
from ..finite import undefined_places
from ..layout import PARAMETER_GROUPS, PARAMETERS, padded, row_count

if TYPE_CHECKING:
    from .model import GaussianModel

_BETA1, _BETA2 = 0.9, 0.999
_CPU_SPAN = 4096
"""Neighbouring columns that a work-item of a CPU steps through."""
_GPU_GROUP = 64
_LARGEST_RATE = 1e37
"""Over the first bias correction, which is a tenth at first, it is still a number."""


class Adam:
    """Adam (Kingma & Ba 2015) for the parameters of a `GaussianModel`.

    Its betas are 0.9 and 0.999 and its epsilon is 1e-15, as in 3DGS. Moments start at zero and are
    bias-corrected as in `torch.optim.Adam`.

    Attributes:
        first_moments, second_moments: `[rows, capacity]`, in the layout of `model.parameters`. An
            edit of the Gaussians replaces them.
    """

    def __init__(self, model: GaussianModel) -> None:
        self._model = model
        self.program = model.device.program("optimization/adam", dtype=model.dtype)
        shape = (model.rows, model.capacity)
        self.first_moments = DeviceArray(model.device, shape, model.dtype)
        self.second_moments = DeviceArray(model.device, shape, model.dtype)
        self._undefined = DeviceArray(model.device, (1,), torch.int32)
        self._told: Callable[[], Tensor] | None = None
        self._steps = dict.fromkeys(PARAMETER_GROUPS, 0)

    @property
    def steps(self) -> int:
        """How many steps were taken by the groups that were skipped least."""
        return max(self._steps.values())

    def step(
        self,
        learning_rates: Mapping[str, float],
        active_sh_degree: float,
        *,
        skip: Collection[str] = (),
    ) -> None:
        """Update the model's parameters from its gradients.

        Args:
            learning_rates: one for each name in `PARAMETER_GROUPS`; 0 leaves a group where it is, but
                its moments take the step.
            active_sh_degree: SH bands above it are skipped; one that counts by a fraction is not.
                That is exact as long as they never had a gradient, because their moments are then zero.
            skip: groups that this step leaves entirely alone, as torch does with what has no gradient:
                parameters, moments, and the count of steps that corrects the moments' bias. "sh" is
                short for both of its groups.

        Raises:
            ExplainedError: a group without a learning rate, a rate for an unknown group, one that is
                not below 1e37, or an unknown group to skip.
        """
        if set(learning_rates) != set(PARAMETER_GROUPS):
            wrong = sorted(set(learning_rates) ^ set(PARAMETER_GROUPS))
            raise ExplainedError(
                f"missing or unknown learning rates: {', '.join(wrong)}",
                where="Adam.step",
                fix=f"give one for each of {', '.join(PARAMETER_GROUPS)}",
            )
        for name, rate in learning_rates.items():
            if not abs(rate) < _LARGEST_RATE:
                raise ExplainedError(
                    f"the learning rate of {name} is {rate}",
                    where=f"Adam.step: {name}",
                    fix=f"give one below {_LARGEST_RATE:g}",
                )
        moving = _groups_without(skip)
        model = self._model
        model.settle_gradients()
        for name in moving:
            self._steps[name] += 1
        real = np.float64 if model.dtype == torch.float64 else np.float32
        # A group that has never moved is not touched below, whatever is made of its zero.
        steps = {name: max(1, taken) for name, taken in self._steps.items()}
        rates = (learning_rates[name] / (1 - _BETA1 ** steps[name]) for name in PARAMETER_GROUPS)
        corrections = ((1 - _BETA2 ** steps[name]) ** -0.5 for name in PARAMETER_GROUPS)
        rows = row_count(min(math.ceil(active_sh_degree), model.sh_degree))
        columns = padded(model.count)
        on_cpu = model.device.variant == "cpu"
        span, group = (_CPU_SPAN, 1) if on_cpu else (1, _GPU_GROUP)
        items = -(-columns // (span * group)) * group
        self.program.run(
            "adam",
            (items, rows),
            (group, 1),
            model.parameters,
            model.gradients,
            self.first_moments,
            self.second_moments,
            *(real(rate) for rate in rates),
            *(real(correction) for correction in corrections),
            np.int32(sum(1 << i for i, name in enumerate(PARAMETER_GROUPS) if name in moving)),
            np.int32(columns),
            np.int32(model.capacity),
            np.int32(span),
            self._undefined,
        )
        self._told = self._undefined.begin_reading()

    def check_parameters(self) -> None:
        """Refuse parameters that a step so far has left undefined.

        Each step looks at the numbers that it moves and sends one of its own, so that this costs nothing
        once the device has been waited for; else it waits for the last step.

        Raises:
            GaussianError: a parameter is not finite; names the first.
        """
        if self._told is None or not int(self._told()):
            return
        for name in PARAMETERS:
            undefined = undefined_places(self._model.read(name))
            if len(undefined):
                raise GaussianError(
                    f"{len(undefined)} values are not finite after the optimizer's step",
                    field=name,
                    index=int(undefined[0, 0]),
                    fix="lower the learning rate, or what else moves this parameter",
                )

    def reset_moments(self, name: str) -> None:
        """Set both moments of one group to zero; 3DGS does so when it resets opacities.

        Raises:
            ExplainedError: there is no such group.
        """
        if name not in PARAMETER_GROUPS:
            raise ExplainedError(
                f"there is no parameter group {name!r}",
                where="Adam.reset_moments",
                fix=f"use one of {', '.join(PARAMETER_GROUPS)}",
            )
        first, last = PARAMETER_GROUPS[name]
        for moments in (self.first_moments, self.second_moments):
            moments.fill(0, first, last)

    def state(self) -> dict[str, Tensor]:
        """Everything needed to continue: copies on the host, for a checkpoint.

        Returns:
            "first_moments" and "second_moments", each `[rows, N]`; "steps", int64 `[6]`, which each
            group has taken.
        """
        count = self._model.count
        return {
            "first_moments": self.first_moments.read()[:, :count].clone(),
            "second_moments": self.second_moments.read()[:, :count].clone(),
            "steps": torch.tensor(list(self._steps.values()), dtype=torch.int64),
        }

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Continue from what `state` returned, for a model with as many Gaussians.

        Raises:
            ExplainedError: an entry is missing or has another shape; nothing is changed then.
        """
        model = self._model
        shapes = {
            "first_moments": (model.rows, model.count),
            "second_moments": (model.rows, model.count),
            "steps": (len(PARAMETER_GROUPS),),
        }
        for name, expected in shapes.items():
            actual = tuple(state[name].shape) if name in state else None
            if actual != expected:
                raise ExplainedError(
                    f"the optimizer state {name!r} has the shape {actual}, expected {expected}",
                    where="Adam.restore",
                    fix="restore it together with the Gaussians that it was saved with",
                )
        for name in ("first_moments", "second_moments"):
            full = torch.zeros(model.rows, model.capacity, dtype=model.dtype)
            full[:, : model.count] = state[name]
            moments = DeviceArray(model.device, (model.rows, model.capacity), model.dtype)
            moments.write(full)
            setattr(self, name, moments)
        self._steps = dict(zip(PARAMETER_GROUPS, state["steps"].tolist(), strict=True))


def _groups_without(skip: Collection[str]) -> list[str]:
    """The groups that a step moves."""
    if unknown := sorted(set(skip) - {*PARAMETER_GROUPS, "sh"}):
        raise ExplainedError(
            f"there is no parameter group {', '.join(map(repr, unknown))}",
            where="Adam.step: skip",
            fix=f"use sh, {', '.join(PARAMETER_GROUPS)}",
        )
    return [
        name
        for name in PARAMETER_GROUPS
        if name not in skip and not ("sh" in skip and name.startswith("sh_"))
    ]
