"""Show a scene in the browser with the package viser; this process renders it."""

from __future__ import annotations

from typing import Any

from registry import RunError

PORT = 8080
"""The port that is tried first."""


def import_viser() -> Any:
    """Import viser, of the extra `viewer`.

    Raises:
        RunError: it is not installed.
    """
    try:
        import viser
    except ImportError as error:
        raise RunError(
            "viewing a scene in the browser needs the package viser",
            fix="pip install 'stereogs-plugins[viewer]'; or, without it, open the page that "
            "`stereogs export RUN --format html` writes",
        ) from error
    return viser
