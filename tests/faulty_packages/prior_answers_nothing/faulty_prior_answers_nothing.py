"""A prior that forgets to return."""

import registry
from registry.priors import MultiViewDepthPrior


class Faulty(MultiViewDepthPrior[registry.Settings]):
    def estimate(self, views, bounds):
        pass


@registry.hookimpl
def stereogs_register_priors(register):
    register("prior_answers_nothing", Faulty)
