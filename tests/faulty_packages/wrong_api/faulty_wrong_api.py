"""It was written for another version of the API."""

import registry

STEREOGS_API = 99


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("wrong_api", Faulty)
