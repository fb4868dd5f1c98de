"""Verbs of the `stereogs` command line, and options of its `train` and `resume`."""

from __future__ import annotations

import argparse
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from registry.pipeline.pipeline import Pipeline
    from registry.runs.options import RunOptions


class Command(ABC):
    """A verb. The first line of its module's docstring is its line in `stereogs --help`.

    `epilog` is printed below the options in `stereogs VERB --help`. The module should import only what
    parsing needs, and `run` the rest, so that help and error messages are fast. A verb
    that sets `computes` runs with one torch thread, as training does.
    """

    epilog: ClassVar[str] = ""
    computes: ClassVar[bool] = False

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:  # noqa: B027
        """Add positional arguments and options."""

    @abstractmethod
    def run(self, arguments: argparse.Namespace) -> int:
        """Do the work; return the exit status: 0 done, 1 a check found a fault.

        Raise an `ExplainedError`, such as `RunError`, for errors that the user can fix.
        """


@dataclass(frozen=True)
class TrainRequest:
    """The command line of one `train` or `resume`.

    Args:
        arguments: as parsed.
        begin: `time.monotonic()` at the start of the command.
        load: returns the `Pipeline` of a name or path, with the scene and the changes of the command line;
            None for `resume`.
        pipeline_named: False if a folder of photographs was given in place of a pipeline.
    """

    arguments: argparse.Namespace
    begin: float
    load: Callable[[str], Pipeline] | None = None
    pipeline_named: bool = True


class TrainOption(ABC):
    """Options that a plugin adds to the verbs in `verbs`."""

    verbs: ClassVar[tuple[str, ...]] = ("train",)

    @abstractmethod
    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add options."""

    @abstractmethod
    def running(
        self, request: TrainRequest, options: RunOptions
    ) -> AbstractContextManager[RunOptions]:
        """Return a context that encloses the training and gives the options to run it with.

        It raises a `RunError` for options that contradict each other; no scene is loaded yet.

        Args:
            request: the command line.
            options: how the training runs by the other options; the context may give a changed copy.
        """
