"""Its loss is zero, and its gradient no number."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        return (step.rendering.alpha * 0).sqrt().sum()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("nan_gradient", Faulty)
