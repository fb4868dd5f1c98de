"""A conformance suite for plugins.

    from registry.testing import check

    def test_my_regularizer():
        check(MyRegularizer, weight_of_something=0.5)

`check` builds the component, calls it as the host would, and checks the results against the contract.
Whether it is useful is for its author to test. `stereogs.testing` offers the same names, and `check_command`.
"""

from __future__ import annotations

from .conformance import Cost, check
from .gaussian_kernels import check_kernel
from .pixel_terms import check_term
from .scenes import step_of, tiny_scene

__all__ = ["Cost", "check", "check_kernel", "check_term", "step_of", "tiny_scene"]
