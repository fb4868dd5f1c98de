"""`held_colors`: freeze the colours of Gaussians that descend from guessed points.

The initializer fills the surface hidden behind a foreground edge with the colour of its visible surroundings.
In training, especially with dropout, these Gaussians show through the foreground and learn its colour, which
appears as a blur next to the edge in novel views. No photograph shows them (kind `hidden` of
`consistency_dense`), so nothing correct can be learned; frozen, they force the foreground to cover them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import HostDefaults, Perturbation, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor


class HeldColorsSettings(Settings):
    kinds: tuple[str, ...] = Field(("hidden",), min_length=1)
    """Kinds of initial points (`PointCloud.kinds`); kinds that the initializer lacks are ignored."""


class HeldColors(Perturbation[HeldColorsSettings]):
    """sh <- sh of the first iteration in which this is due, for descendants of some kinds of points."""

    host_defaults = HostDefaults(every=10)

    _first: Tensor | None = None
    """`[N, K, 3]`, of all Gaussians."""

    def offsets(self, step: Step) -> Mapping[str, Tensor]:
        """Return the offsets of the coefficients `[N, K, 3]`, 0 for all other Gaussians."""
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
        """Give the children of a split Gaussian its colours."""
        if self._first is not None:
            self._first = self._first[source]

    def state(self) -> dict[str, Tensor]:
        """Return the colours, for a checkpoint."""
        return {} if self._first is None else {"first": self._first}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned."""
        self._first = state.get("first")


@hookimpl
def stereogs_register_perturbations(register: Register[HeldColors]) -> None:
    register("held_colors", HeldColors)
