"""Packages that a plugin needs and that may not be installed."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ..errors import PluginError


def optional_module(
    name: str, install: str, then: str = "`stereogs resume RUN` then continues a started run"
) -> Any:
    """Import a module of an optional package.

    Args:
        name: full name of the module.
        install: the command that installs it.
        then: what to do after the installation; empty: the same command again.

    Raises:
        PluginError: it cannot be imported.
    """
    try:
        return import_module(name)
    except ImportError as error:
        fix = f"{install}; {then}" if then else install
        raise PluginError(f"{name} cannot be imported: {error}", fix=fix) from error
