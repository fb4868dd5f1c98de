"""It does not follow a change of topology."""

import torch

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def __init__(self, settings, context):
        super().__init__(settings, context)
        self.ages = torch.zeros(0)

    def loss(self, step):
        if not len(self.ages):
            self.ages = torch.zeros(step.model.count)
        self.ages.add_(1)
        return step.rendering.alpha.mean()

    def state(self):
        return {"ages": self.ages}

    def restore(self, state):
        self.ages = state["ages"].clone()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("missing_carry", Faulty)
