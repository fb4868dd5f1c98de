"""viser, the package that shows a page and hears what happens in it."""

from __future__ import annotations

from typing import Any

from registry import RunError


def import_viser() -> Any:
    """The module.

    Raises:
        RunError: it is not installed.
    """
    try:
        import viser
    except ImportError as error:
        raise RunError(
            "looking at a scene in the browser needs the package viser",
            fix="pip install 'stereogs-plugins[viewer]'",
        ) from error
    return viser
