"""It never comes back."""

import time

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        if step.iteration == 5:
            time.sleep(3600)
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("hangs", Faulty)
