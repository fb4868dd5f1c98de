"""List the largest Gaussians of a run."""

import argparse

from stereogs import api

STEREOGS_API = 1
"""The version of the plugin API that this module was written for."""


class Largest(api.Command):
    """The verb `largest`: centres and sizes of the Gaussians with the largest standard deviations."""

    epilog = "examples:\n  stereogs largest runs/3dgs-fern --count 5\n"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the run folder and --count."""
        api.add_run(parser)
        parser.add_argument("--count", type=int, default=10, metavar="N", help="rows to print")

    def run(self, arguments: argparse.Namespace) -> int:
        """Print a row for each; torch is imported by `open_given`, after the arguments are parsed."""
        gaussians = api.open_given(arguments).model.gaussians()
        sizes = gaussians.log_scales.exp().amax(dim=1)
        for index in sizes.argsort(descending=True)[: arguments.count].tolist():
            x, y, z = gaussians.means[index].tolist()
            api.console().print(f"{sizes[index]:10.4f}  at {x:9.3f} {y:9.3f} {z:9.3f}")
        return 0


@api.hookimpl
def stereogs_register_commands(register: api.Register[api.Command]) -> None:
    register("largest", Largest)
