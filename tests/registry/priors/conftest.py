"""A cache for the answers of priors."""

from tests.registry.toolkit.networks.conftest import cache

__all__ = ["cache"]
