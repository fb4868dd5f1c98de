"""What a component may ask of the host besides the colours, depth and alpha of the iteration's view."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal, get_args

from ..errors import PluginError

Rendered = Literal[
    "normals", "contributions", "other_fields", "screen_gradient", "absolute_screen_gradient"
]
"""Outputs that `Component.needs_rendered` names: those of `Step`, and two of `step.model`."""

RENDERED: tuple[Rendered, ...] = get_args(Rendered)
COLLECTED = frozenset(("screen_gradient", "absolute_screen_gradient"))
"""Sums over the iterations since the last edit; the others belong to one iteration."""


@dataclass
class Access:
    """The outputs that the component which is being called may use.

    Attributes:
        declared: answer of its `needs_rendered`; None outside a training, where everything is allowed.
    """

    declared: Collection[str] | None = None

    def refuse_undeclared(self, name: str) -> None:
        """Raise a PluginError if the component uses an output that it does not declare."""
        if self.declared is not None and name not in self.declared:
            raise PluginError(
                f"it uses {name!r}, which it does not declare, so that the host may not have made it",
                fix=f"return {name!r} from the component's `needs_rendered`",
            )
