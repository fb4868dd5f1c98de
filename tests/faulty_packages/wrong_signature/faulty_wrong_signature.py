"""Its method takes no step."""

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self):
        return 0.0


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("wrong_signature", Faulty)
