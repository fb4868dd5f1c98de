"""A cache folder for estimates of priors."""

from tests.registry.toolkit.networks.conftest import cache

__all__ = ["cache"]
