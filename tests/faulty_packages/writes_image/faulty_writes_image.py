"""It copies its own render over the photograph."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        step.view.image.copy_(step.rendering.rgb.detach())
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("writes_image", Faulty)
