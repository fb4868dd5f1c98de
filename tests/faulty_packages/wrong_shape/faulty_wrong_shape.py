"""Its loss is an image."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        return step.rendering.alpha


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("wrong_shape", Faulty)
