"""It measures its own picture."""

import registry


class Faulty(registry.Metric[registry.Settings]):
    def measure(self, rendered, photograph, mask):
        rendered.copy_(photograph)
        return 99.0


@registry.hookimpl
def stereogs_register_metrics(register):
    register("writes_rendering", Faulty)
