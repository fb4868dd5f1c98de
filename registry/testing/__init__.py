"""A conformance suite: what a plugin author runs on a component of their own.

    from registry.testing import check

    def test_my_regularizer():
        check(MyRegularizer, weight_of_something=0.5)

It builds the component, asks it what the host would ask, and holds the answers to the contract. What a
component is *good* for, its author must test.
"""

from __future__ import annotations

from .conformance import Cost, check
from .scenes import step_of, tiny_scene

__all__ = ["Cost", "check", "step_of", "tiny_scene"]
