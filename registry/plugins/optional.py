"""Packages that not everybody has."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ..errors import PluginError


def optional_module(
    name: str,
    install: str,
    then: str = "`stereogs resume RUN` then goes on with a run that has begun",
) -> Any:
    """A module of a package that an extra brings; imported when it is needed, not before.

    Args:
        name: the module's, in full.
        install: the command that installs it.
        then: what to do once it is installed; empty: the same again.

    Raises:
        PluginError: it cannot be imported.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise PluginError(
            f"{name} cannot be imported: {error}",
            fix=f"{install}; {then}" if then else install,
        ) from error
