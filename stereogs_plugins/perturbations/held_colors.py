"""`held_colors`: Gaussians that descend from guessed points keep the colours that they were guessed with.

What lies behind the edge of something near is guessed by the initializer in the colour of what is seen
beside it. In training it shines through what is before it, above all with dropout, and learns the colour of
that: a blur of the foreground's colour stands beside it in the next camera. Where no photograph shows it (the
kind `hidden` of `consistency_dense`), nothing true can be learned. Held, it leaves the foreground only one
way to be right: to cover it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Perturbation, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor


class HeldColorsSettings(Settings):
    kinds: tuple[str, ...] = Field(("hidden",), min_length=1)
    """Of initial points (`PointCloud.kinds`). A kind that the initializer does not have holds nothing."""


class HeldColors(Perturbation[HeldColorsSettings]):
    """sh <- sh in the first iteration in which this is due, for the descendants of some kinds of points."""

    _first: Tensor | None = None
    """`[N, K, 3]`, of all Gaussians, so that it follows them as they are."""

    def offsets(self, step: Step) -> Mapping[str, Tensor]:
        """Return the offsets of the coefficients `[N, K, 3]`, 0 for all other Gaussians; at first, none."""
        import torch

        held = [step.kinds[kind] for kind in self.settings.kinds if kind in step.kinds]
        if not held:
            return {}
        now = step.model.read("sh")
        if self._first is None:
            self._first = now.clone()
        rows = torch.stack(held).any(dim=0)
        return {"sh": torch.where(rows[:, None, None], self._first - now, 0)}

    def carry(self, source: Tensor, fresh: Tensor) -> None:
        """A part of a Gaussian that was split keeps the colours of the whole."""
        if self._first is not None:
            self._first = self._first[source]

    def state(self) -> dict[str, Tensor]:
        """Return the colours, for a checkpoint."""
        return {} if self._first is None else {"first": self._first}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take back what `state` returned."""
        self._first = state.get("first")


@hookimpl
def stereogs_register_perturbations(register: Register[HeldColors]) -> None:
    register("held_colors", HeldColors)
