"""Its hook is one that nobody calls."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularisers(register):
    register("misspelt_hook", Faulty)
