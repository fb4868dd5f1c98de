"""Fixtures of the host's tests, which tests of verbs use too."""

from tests.registry.conftest import _no_installed_plugins, device, extension_points, install, toys

__all__ = ["_no_installed_plugins", "device", "extension_points", "install", "toys"]
