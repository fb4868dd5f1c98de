"""It keeps something of every iteration, for ever."""

import torch

import registry


class Sick(registry.Regularizer[registry.Settings]):
    def __init__(self, settings, context):
        super().__init__(settings, context)
        self.kept = []

    def loss(self, step):
        self.kept.append(torch.ones(8_000_000))
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("grows_memory", Sick)
