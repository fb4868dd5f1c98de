"""Its loss is no tensor."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        return float(step.rendering.alpha.mean().detach())


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("float_loss", Faulty)
