"""It follows a change of topology to the wrong place."""

import torch

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def __init__(self, settings, context):
        super().__init__(settings, context)
        self.ages = torch.zeros(0)

    def loss(self, step):
        if not len(self.ages):
            self.ages = torch.zeros(step.model.count)
        self.ages += 1
        return step.rendering.alpha.mean()

    def state(self):
        return {"ages": self.ages}

    def restore(self, state):
        self.ages = state["ages"].clone()

    def carry(self, source, fresh):
        self.ages = self.ages[source + 1]


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("wrong_carry", Faulty)
