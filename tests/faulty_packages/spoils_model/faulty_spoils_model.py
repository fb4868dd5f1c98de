"""It writes a NaN into the Gaussians, where the host does not look."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        rows = step.model._model.parameters
        values = rows.read().clone()
        values[3, 7] = float("nan")
        rows.write(values)
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("spoils_model", Faulty)
