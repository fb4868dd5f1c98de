"""It writes into the Gaussians, through what is private."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        step.model._model.write("means", 0.5 * step.model.read("means"))
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("writes_model", Faulty)
