"""A conformance suite for plugins.

    from stereogs.testing import check

    def test_my_regularizer():
        check(MyRegularizer, weight_of_something=0.5)

`check` builds the component, calls it as the host would, and checks the results against the contract.
`check_term` and `check_kernel` compare a `PixelTerm` and a `GaussianKernel` with torch, and `check_command`
checks a command of the command line.
Whether a component is useful is for its author to test.
"""

from __future__ import annotations

from registry.testing import Cost, check, check_kernel, check_term, step_of, tiny_scene

from .command_line.conformance import check_command

__all__ = ["Cost", "check", "check_command", "check_kernel", "check_term", "step_of", "tiny_scene"]
