"""It moves the cameras."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        step.scene.train[1].camera.world_to_camera[0, 3] += 0.1
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("writes_camera", Faulty)
