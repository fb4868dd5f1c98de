"""Verbs of the `stereogs` command line, and options of its `train` and `resume`."""

from __future__ import annotations

import argparse
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, ClassVar


class Command(ABC):
    """A verb. The first line of its module's docstring is its line in `stereogs --help`.

    `epilog` is printed below the options in `stereogs VERB --help`. The module should import only what
    parsing needs, and `run` the rest, so that help and error messages are fast.
    """

    epilog: ClassVar[str] = ""

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
    load: Callable[[str], Any] | None = None
    pipeline_named: bool = True


class TrainOption(ABC):
    """Options that a plugin adds to the verbs in `verbs`."""

    verbs: ClassVar[tuple[str, ...]] = ("train",)
    folder_pipeline: ClassVar[str | None] = None
    """Name of the pipeline that trains a folder when the command names no pipeline."""

    @abstractmethod
    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add options."""

    @abstractmethod
    def running(self, request: TrainRequest, options: Any) -> AbstractContextManager[Any]:
        """Return a context that encloses the training and gives the options to run it with.

        It raises a `RunError` for options that contradict each other; no scene is loaded yet.

        Args:
            request: the command line.
            options: `registry.runs.options.RunOptions`; the context gives the same type.
        """
