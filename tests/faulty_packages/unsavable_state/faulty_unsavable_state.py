"""What it remembers cannot be saved."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        return step.rendering.alpha.mean()

    def state(self):
        return {"seen": ["view0"]}


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("unsavable_state", Faulty)
