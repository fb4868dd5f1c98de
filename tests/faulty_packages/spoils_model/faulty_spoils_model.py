"""After its first call it writes a NaN into the Gaussians, where the host does not look."""

import torch

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    calls = torch.zeros(())

    def loss(self, step):
        if self.calls:
            rows = step.model._model.parameters
            values = rows.read().clone()
            values[3, 7] = float("nan")
            rows.write(values)
        self.calls = self.calls + 1
        return step.rendering.alpha.mean()

    def state(self):
        return {"calls": self.calls}

    def restore(self, state):
        self.calls = state["calls"]


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("spoils_model", Faulty)
