"""Try the network in an ONNX file on a known scene."""

from __future__ import annotations

import argparse
import logging
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from registry import Command, Register, hookimpl
from registry.commands import add_device, console

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rich.console import Console

    from core_rasterizer import Device
    from registry.toolkit.networks import OnnxModel

    from .prior_trials import Guess, Trial
    from .prior_truth import Truth

FAULT = 1

_EPILOG = """\
examples:
  stereogs priors check stereo.onnx
  stereogs priors check depth.onnx --set size=[512,384]  known already
  stereogs priors check xfeat.onnx --set matcher=lighterglue.onnx

It shows the file's inputs and outputs, asks every installed prior with which settings it would run the
file, tries them on a drawn room whose depths are known, and prints errors, seconds and the YAML of the
best. What a network's numbers mean (0..1 or 0..255, depth or its inverse) cannot be read from a file;
a wrong guess gives plausible nonsense, and only its error tells.
Exit status 1 if no guess gave an answer.
"""


class Priors(Command):
    """The verb `priors`."""

    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the action `check`."""
        actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
        check = actions.add_parser(
            "check",
            help="guess the settings that run a file, and try them",
            epilog=_EPILOG,
            formatter_class=parser.formatter_class,
        )
        check.add_argument("model", type=Path, metavar="MODEL.onnx", help="the file")
        check.add_argument(
            "--set",
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="fix a setting of the prior",
        )
        add_device(check)

    def run(self, arguments: argparse.Namespace) -> int:
        """Describe the file, guess settings, try them and print; 1 if nothing worked."""
        from core_rasterizer import open_device
        from registry.plugins import Plugins
        from registry.toolkit.networks import OnnxModel
        from registry.training import one_torch_thread

        from .prior_trials import guesses, known_truth

        output, plugins = console(), Plugins()
        model = OnnxModel(arguments.model)
        _describe(model, output)
        found = guesses(model, plugins, arguments.set)
        device = open_device(arguments.device)
        with one_torch_thread(), _silence():
            truth = known_truth(plugins, device)
            trials = list(_tried(found, truth, device, output))
        if not trials:
            output.print("no guess gave an answer")
            return FAULT
        best = min(trials, key=lambda trial: trial.score.error)
        _conclude(best, output)
        return 0


@contextmanager
def _silence() -> Iterator[None]:
    """Models do not tell what their answers cost: each line here says it."""
    log = logging.getLogger("stereogs.priors")
    before = log.level
    log.setLevel(logging.WARNING)
    try:
        yield
    finally:
        log.setLevel(before)


def _describe(model: OnnxModel, output: Console) -> None:
    output.print(f"{model.path}\n  SHA-256  {model.sha256}")
    output.print(f"  run on   {model.provider}, {model.threads} threads")
    for kind, specs in (("input", model.inputs), ("output", model.outputs)):
        for spec in specs:
            output.print(f"  {kind:<7}  {spec}")


def _tried(
    found: Iterable[Guess], truth: Truth, device: Device, output: Console
) -> Iterable[Trial]:
    """Those that gave an answer; says how each went."""
    from core_rasterizer import ExplainedError

    from .prior_trials import attempt

    for guess in found:
        said = {
            key: value for key, value in guess.settings.items() if key not in ("model", "sha256")
        }
        label = " ".join([guess.offer.name, *(f"{key}={value}" for key, value in said.items())])
        try:
            trial = attempt(guess, truth, device)
        except ExplainedError as error:
            output.print(f"{label}: failed: {error.what}")
            continue
        output.print(f"{label}: error {trial.score.error:.3f}, {trial.seconds:.2f} s")
        yield trial


def _conclude(best: Trial, output: Console) -> None:
    from registry.system import peak_memory_mb

    output.print(f"\nbest: {best.score.text}")
    memory = peak_memory_mb()
    at_most = "" if memory is None else f"; memory of this process at most {memory:.0f} MB"
    output.print(f"{best.seconds:.2f} s{at_most}\n")
    output.print(best.guess.to_yaml())


@hookimpl
def stereogs_register_commands(register: Register[Command]) -> None:
    register("priors", Priors)
