"""Its loss is not a number."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        return step.rendering.alpha.mean() * float("nan")


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("nan_loss", Faulty)
