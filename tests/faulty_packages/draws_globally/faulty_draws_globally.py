"""No two runs of it are the same."""

import torch

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        return step.rendering.alpha.mean() * torch.rand(())


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("draws_globally", Faulty)
