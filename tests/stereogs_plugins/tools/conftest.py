"""Toy plugins for tests of verbs; the fixtures of the host's tests."""

from tests.registry.commands.conftest import pipeline
from tests.registry.conftest import _no_installed_plugins, device, extension_points, install, toys

__all__ = ["_no_installed_plugins", "device", "extension_points", "install", "pipeline", "toys"]
