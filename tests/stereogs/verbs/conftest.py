"""Toy plugins for tests of verbs; the fixtures of the host's tests."""

from tests.registry.conftest import _no_installed_plugins, device, extension_points, install, toys
from tests.stereogs.command_line.conftest import pipeline

__all__ = ["_no_installed_plugins", "device", "extension_points", "install", "pipeline", "toys"]
