"""It keeps something of every iteration, for ever."""

import mmap

import registry


class Faulty(registry.Regularizer[registry.Settings]):
    def __init__(self, settings, context):
        super().__init__(settings, context)
        self.kept = []

    def loss(self, step):
        pages = mmap.mmap(-1, 32_000_000)  # new pages: an allocator may reuse freed ones
        pages.write(bytes([1]) * 32_000_000)
        self.kept.append(pages)
        return step.rendering.alpha.mean()


@registry.hookimpl
def stereogs_register_regularizers(register):
    register("grows_memory", Faulty)
