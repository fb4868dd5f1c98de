"""It leaves a thread behind."""

import threading
import time

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def loss(self, step):
        threading.Thread(target=time.sleep, args=(1,), name="leftover", daemon=True).start()
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("leaves_thread", Faulty)
