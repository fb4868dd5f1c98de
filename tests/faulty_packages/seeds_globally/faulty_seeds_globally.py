"""It makes its own numbers repeatable, and everybody's."""

import torch

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        torch.manual_seed(0)
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("seeds_globally", Faulty)
