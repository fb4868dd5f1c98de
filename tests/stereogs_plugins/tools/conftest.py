"""Toy plugins for tests of verbs; the fixtures of the host's tests."""

from tests.registry.commands.conftest import pipeline
from tests.registry.conftest import _no_installed_plugins, device, doors, install, toys

__all__ = ["_no_installed_plugins", "device", "doors", "install", "pipeline", "toys"]
