"""Answers for a shell that completes a command line with the tab key."""

from __future__ import annotations

import argparse
from typing import Any

_PIPELINES = ("pipeline", "file", "data")
"""Arguments that take the name of a ready pipeline."""


def answer_shell(parser: argparse.ArgumentParser) -> None:
    """Print how the line may continue, and exit."""
    import argcomplete

    # Any callable will do, whatever its annotation says.
    argcomplete.autocomplete(parser, default_completer=_complete)  # type: ignore[arg-type]


def _complete(prefix: str, action: argparse.Action, **_: Any) -> list[str]:
    from argcomplete.completers import FilesCompleter

    if action.dest == "name":
        from ..plugins.discovery import Plugins, offered_name

        return [name for e in Plugins().entries if (name := offered_name(e)).startswith(prefix)]
    found = [str(path) for path in FilesCompleter()(prefix)]
    if action.dest in _PIPELINES:
        from ..pipeline.ready import ready_pipelines

        found += [name for name in ready_pipelines() if name.startswith(prefix)]
    return found
