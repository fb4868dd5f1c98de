"""Results would go elsewhere."""

import os

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        os.chdir("..")
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("changes_folder", Faulty)
