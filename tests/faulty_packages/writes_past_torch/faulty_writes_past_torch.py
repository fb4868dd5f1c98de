"""It copies its own render over the photograph, where torch does not look."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        step.view.image.numpy()[:] = step.rendering.rgb.detach().numpy()
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("writes_past_torch", Faulty)
