"""It moves the scene's points."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        step.scene.points.positions.mul_(2)
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("writes_points", Faulty)
