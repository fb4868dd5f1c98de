"""Its loss has no gradient: `read` gives a copy outside autograd."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        return step.model.read("means").abs().mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("constant_loss", Faulty)
