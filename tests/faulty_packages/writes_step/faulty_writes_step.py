"""It changes the learning rates."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        step.learning_rates["means"] = 0.0
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("writes_step", Faulty)
