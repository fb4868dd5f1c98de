"""It fails in the middle of the run."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        if step.iteration == 5:
            raise KeyError("a view that is not there")
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("error_at_iteration", Faulty)
