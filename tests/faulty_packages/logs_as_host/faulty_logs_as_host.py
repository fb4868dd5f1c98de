"""It overwrites a number of the host's."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        step.log("loss", 0.0)
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("logs_as_host", Faulty)
