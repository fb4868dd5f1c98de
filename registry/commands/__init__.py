"""Consoles, arguments and output that several verbs use."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from ..contract.command import TrainRequest
    from .arguments import (
        add_accept_changed,
        add_changes,
        add_device,
        add_run,
        open_given,
        positive_seconds,
    )
    from .output import ABSENT, conclude, console, print_failures, results_table
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "ABSENT",
    "TrainRequest",
    "add_accept_changed",
    "add_changes",
    "add_device",
    "add_run",
    "conclude",
    "console",
    "open_given",
    "positive_seconds",
    "print_failures",
    "results_table",
]
