"""A prior that skips a view."""

import registry
from registry.priors import MultiViewDepthPrior


class Faulty(MultiViewDepthPrior[registry.Settings]):
    def estimate(self, views, bounds):
        return []


@registry.hookimpl
def stereogs_register_priors(register):
    register("prior_answers_too_few", Faulty)
