"""Adam on the device: one pass over parameters, gradients and moments."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping

import torch
from torch import Tensor

from ..device import DeviceArray
from ..errors import ExplainedError, GaussianError
from ..gaussians import undefined_places
from ..layout import PARAMETER_GROUPS, PARAMETERS, padded, row_count
from .storage import GaussianStorage

_BETA1, _BETA2 = 0.9, 0.999
_MAX_RATE = 1e37
"""Stays finite when divided by the first bias correction, 0.1 at the first step."""


class Adam:
    """Adam (Kingma & Ba 2015) for the parameters of a `GaussianModel`.

    As in 3DGS the betas are 0.9 and 0.999 and epsilon is 1e-15. Moments start at zero and are
    bias-corrected as in `torch.optim.Adam`.

    Attributes:
        first_moments, second_moments: `[rows, capacity]`, in the layout of `model.parameters`.
            `apply_edit` replaces them.
    """

    def __init__(self, model: GaussianStorage) -> None:
        self._model = model
        self.program = model.device.program(
            "optimization/adam_values", "optimization/adam", dtype=model.dtype
        )
        shape = (model.rows, model.capacity)
        self.first_moments = DeviceArray(model.device, shape, model.dtype)
        self.second_moments = DeviceArray(model.device, shape, model.dtype)
        self._undefined = DeviceArray(model.device, (1,), torch.int32)
        self._read_undefined: Callable[[], Tensor] | None = None
        self._steps = dict.fromkeys(PARAMETER_GROUPS, 0)

    @property
    def steps(self) -> int:
        """Number of steps of the group that was skipped least."""
        return max(self._steps.values())

    def step(
        self,
        learning_rates: Mapping[str, float],
        active_sh_degree: float,
        *,
        skip: Collection[str] = (),
        keep_gradients: bool = True,
    ) -> None:
        """Update the model's parameters from its gradients.

        If opacities take part, their logits beyond +-30 become +-30 (`MAX_LOGIT`), also with a rate of 0.

        Args:
            learning_rates: one for each name in `PARAMETER_GROUPS`; with 0 the values stay, but the
                moments are updated.
            active_sh_degree: SH bands above it, rounded up, are skipped. That is exact while they have
                never had a gradient, because their moments are then zero.
            skip: groups whose parameters, moments and step count this step does not change, as torch
                treats parameters without a gradient. "sh" means both of its groups.
            keep_gradients: If False, gradients that nobody has read since the backward pass are never
                stored, which saves time, with the same results. Reading gradients after the step then
                raises a GaussianError.

        Raises:
            ExplainedError: missing or unknown groups in `learning_rates`, a rate not below 1e37, or an
                unknown group in `skip`.
        """
        if set(learning_rates) != set(PARAMETER_GROUPS):
            wrong = sorted(set(learning_rates) ^ set(PARAMETER_GROUPS))
            raise ExplainedError(
                f"missing or unknown learning rates: {', '.join(wrong)}",
                where="Adam.step",
                fix=f"give one for each of {', '.join(PARAMETER_GROUPS)}",
            )
        for name, rate in learning_rates.items():
            if not abs(rate) < _MAX_RATE:
                raise ExplainedError(
                    f"the learning rate of {name} is {rate}",
                    where=f"Adam.step: {name}",
                    fix=f"give one below {_MAX_RATE:g}",
                )
        moving = _groups_without(skip)
        self._model.steps += 1
        gradients = self._model.gradients
        deferred = None if keep_gradients else gradients.take_deferred()
        if deferred is None:
            gradients.store()
        for name in moving:
            self._steps[name] += 1
        rows = row_count(min(math.ceil(active_sh_degree), self._model.sh_degree))
        arguments: dict[str, DeviceArray | float] = {
            "first_moments": self.first_moments,
            "second_moments": self.second_moments,
            **self._rates(learning_rates),
            "moving": sum(1 << i for i, name in enumerate(PARAMETER_GROUPS) if name in moving),
            "undefined": self._undefined,
        }
        if deferred is None:
            self._run(gradients.rows, arguments, rows)
        else:
            deferred.step(**arguments, rows=rows)
        if not keep_gradients:
            gradients.mark_used()
        self._read_undefined = self._undefined.begin_reading()

    def _rates(self, learning_rates: Mapping[str, float]) -> dict[str, float]:
        """Kernel arguments: the groups' learning rates and corrections for this step."""
        # The kernel skips groups without a step, so their correction only has to be finite.
        steps = {name: max(1, taken) for name, taken in self._steps.items()}
        rates = {name: learning_rates[name] / (1 - _BETA1 ** steps[name]) for name in steps}
        return rates | {f"correct_{name}": (1 - _BETA2**n) ** -0.5 for name, n in steps.items()}

    def _run(
        self, gradients: DeviceArray, arguments: Mapping[str, DeviceArray | float], rows: int
    ) -> None:
        """Step from stored gradients."""
        model = self._model
        columns = padded(model.count)
        span, group = model.device.profile.adam_span, model.device.profile.adam_group
        items = -(-columns // (span * group)) * group
        self.program.run(
            "adam",
            (items, rows),
            (group, 1),
            parameters=model.parameters,
            gradients=gradients,
            columns=columns,
            capacity=model.capacity,
            span=span,
            **arguments,
        )

    def check_parameters(self) -> None:
        """Raise if a step has produced a parameter that is not finite.

        Waits for the last step. If the device has been waited for since, this costs nothing: each step
        checks the values that it changes and transfers one flag.

        Raises:
            GaussianError: a parameter is not finite; names the first.
        """
        if self._read_undefined is None or not int(self._read_undefined()):
            return
        for name in PARAMETERS:
            undefined = undefined_places(self._model.read(name))
            if len(undefined):
                raise GaussianError(
                    f"{len(undefined)} values are not finite after the optimizer's step",
                    field=name,
                    index=int(undefined[0, 0]),
                    fix="lower the learning rate of this parameter",
                )

    def reset_moments(self, name: str) -> None:
        """Set both moments of one group to zero, as 3DGS does when it resets opacities.

        Raises:
            ExplainedError: unknown group.
        """
        if name not in PARAMETER_GROUPS:
            raise ExplainedError(
                f"unknown parameter group {name!r}",
                where="Adam.reset_moments",
                fix=f"use one of {', '.join(PARAMETER_GROUPS)}",
            )
        first, last = PARAMETER_GROUPS[name]
        for moments in (self.first_moments, self.second_moments):
            moments.fill(0, first, last)

    def state(self) -> dict[str, Tensor]:
        """The optimizer's state for a checkpoint, copied to the host.

        Returns:
            "first_moments" and "second_moments", each `[rows, N]`; "steps", int64 `[6]`, one for each
            group.
        """
        count = self._model.count
        return {
            "first_moments": self.first_moments.read()[:, :count].clone(),
            "second_moments": self.second_moments.read()[:, :count].clone(),
            "steps": torch.tensor(list(self._steps.values()), dtype=torch.int64),
        }

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Continue from `state`, for a model with the same number of Gaussians.

        Raises:
            ExplainedError: an entry is missing or has the wrong shape; nothing changes then.
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
                    fix="restore it together with its Gaussians",
                )
        for name in ("first_moments", "second_moments"):
            full = torch.zeros(model.rows, model.capacity, dtype=model.dtype)
            full[:, : model.count] = state[name]
            moments = DeviceArray(model.device, (model.rows, model.capacity), model.dtype)
            moments.write(full)
            setattr(self, name, moments)
        self._steps = dict(zip(PARAMETER_GROUPS, state["steps"].tolist(), strict=True))


def _groups_without(skip: Collection[str]) -> list[str]:
    """The groups that a step changes."""
    if unknown := sorted(set(skip) - {*PARAMETER_GROUPS, "sh"}):
        raise ExplainedError(
            f"unknown parameter group {', '.join(map(repr, unknown))}",
            where="Adam.step: skip",
            fix=f"use sh, {', '.join(PARAMETER_GROUPS)}",
        )
    return [
        name
        for name in PARAMETER_GROUPS
        if name not in skip and not ("sh" in skip and name.startswith("sh_"))
    ]
