"""A conformance suite: what a plugin author runs on a component of their own.

    from registry.testing import check

    def test_my_regularizer():
        check(MyRegularizer, weight_of_something=0.5)

It builds the component on a tiny scene, asks it what the host would ask, and holds the answers to the
contract: shapes, types, finite values, gradients, and the same answer for the same seed. What a
component is *good* for, its author must test.
"""

from __future__ import annotations

from .bench import step_of, tiny_scene
from .conformance import check

__all__ = ["check", "step_of", "tiny_scene"]
