"""`iterate_averaging`: at the end, every parameter becomes its mean over the last iterations (Polyak 1992).

Steps of a stochastic optimizer end up around a minimum, not in it: each was made for one photograph, and
with dropout for one draw of the Gaussians. Their mean lies nearer, as if the learning rates had gone to
zero, at the cost of a sum. Give it `start: 80%` or so, after the last growth: whenever Gaussians come or
go the mean begins anew.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry import Context, Perturbation, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

PARAMETERS = ("means", "log_scales", "quaternions", "opacity_logits", "sh")


class IterateAveraging(Perturbation[Settings]):
    """theta <- mean of theta over the iterations that it was due in, in the run's last one.

    It must be due in the last iteration to have an effect. Of an opacity the logit is averaged, of a scale
    the logarithm, of a rotation the quaternion.
    """

    def __init__(self, settings: Settings, context: Context) -> None:
        super().__init__(settings, context)
        self._sums: dict[str, Tensor] = {}
        self._count = 0

    def offsets(self, step: Step) -> Mapping[str, Tensor]:
        """Return the way from the last parameters to their means; nothing before the last iteration."""
        values = {name: step.model.read(name) for name in PARAMETERS}
        for name, value in values.items():
            known = self._sums.get(name)
            self._sums[name] = value.double() if known is None else known.add_(value)
        self._count += 1
        if step.iteration < step.iterations:
            return {}
        return {
            name: (self._sums[name] / self._count - value).float() for name, value in values.items()
        }

    def carry(self, source: Tensor, fresh: Tensor) -> None:
        """Begin anew: a mean over other Gaussians would be of nobody."""
        self._sums, self._count = {}, 0

    def state(self) -> dict[str, Tensor]:
        """The sums so far, and of how many iterations."""
        import torch

        sums = {name: total.clone() for name, total in self._sums.items()}
        return {"count": torch.tensor(self._count), **sums}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take back what `state` returned."""
        self._count = int(state["count"])
        self._sums = {name: state[name].clone() for name in PARAMETERS if name in state}


@hookimpl
def stereogs_register_perturbations(register: Register[IterateAveraging]) -> None:
    register("iterate_averaging", IterateAveraging)
