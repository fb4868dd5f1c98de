"""It offers a component under the name of another."""

import registry


class Faulty(registry.Metric[registry.Settings]):
    def measure(self, rendered, photograph, mask):
        return 99.0


@registry.hookimpl
def stereogs_register_metrics(register):
    register("psnr", Faulty)
