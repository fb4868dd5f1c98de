"""A conformance suite for plugins.

    from registry.testing import check

    def test_my_regularizer():
        check(MyRegularizer, weight_of_something=0.5)

`check` builds the component, calls it as the host would, and checks the results against the contract.
`check_command` checks a command of the command line. Whether a component is useful is for its author to test.
"""

from __future__ import annotations

from .conformance import Cost, check, check_command
from .scenes import step_of, tiny_scene

__all__ = ["Cost", "check", "check_command", "step_of", "tiny_scene"]
