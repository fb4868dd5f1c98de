"""Its factors are whole numbers."""

import torch

import registry


class Faulty(registry.Modifier[registry.Settings]):
    def opacity_scale(self, step):
        return torch.ones(step.model.count, dtype=torch.int64)


@registry.hookimpl
def stereogs_register_modifiers(register):
    register("wrong_dtype", Faulty)
