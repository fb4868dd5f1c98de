"""A prior that fails."""

import registry
from registry.priors import MultiViewDepthPrior


class Faulty(MultiViewDepthPrior[registry.Settings]):
    def estimate(self, views, bounds):
        raise ValueError("no network")


@registry.hookimpl
def stereogs_register_priors(register):
    register("prior_raises", Faulty)
