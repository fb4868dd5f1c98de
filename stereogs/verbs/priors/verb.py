"""Test the network in an ONNX or TorchScript file on a scene with known depth."""

from __future__ import annotations

import argparse
import logging
from contextlib import contextmanager
from typing import TYPE_CHECKING

from registry.toolkit.cache.remote import on_this_machine

from ...command_line.arguments import add_device
from ...command_line.command import Command
from ...command_line.output import console

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rich.console import Console

    from core_rasterizer import Device
    from registry.toolkit.networks import OnnxModel

    from .prior_trials import Guess, Trial, Truth

FAULT = 1
SCRIPTS = (".pt", ".ts")
"""Suffixes of TorchScript files; others are ONNX."""
LONGEST = 120.0
"""Seconds for each answer on the small scene: an endless loop ends then."""

_EPILOG = """\
examples:
  stereogs priors check stereo.onnx
  stereogs priors check depth.onnx --set size=[512,384]  a known setting
  stereogs priors check xfeat.onnx --set matcher=lighterglue.onnx
  stereogs priors check patchmatchnet.pt                 runs its code: only files that you trust

Prints the file's inputs and outputs, tries the settings that each installed prior suggests for the file
on a rendered room with known depth, and prints errors, seconds and the YAML of the best settings. A file
does not say what its numbers mean (0..1 or 0..255, depth or inverse depth); wrong settings give plausible
but wrong results, which only the error reveals. A multi-view network is run with two and with three views,
and refused if it is right for one number only. Each answer may take two minutes. Exit status 1 if no settings
worked.
"""


class Priors(Command):
    epilog = _EPILOG
    computes = True

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the action `check`."""
        actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
        check = actions.add_parser(
            "check",
            help="find the settings that run a file by trying them",
            epilog=_EPILOG,
            formatter_class=parser.formatter_class,
        )
        check.add_argument(
            "model", type=on_this_machine, metavar="MODEL", help="ONNX, or TorchScript (.pt, .ts)"
        )
        check.add_argument(
            "--set",
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="use this value of a setting of the prior",
        )
        add_device(check)

    def run(self, arguments: argparse.Namespace) -> int:
        """Print the file's properties, try settings and print the best; return 1 if none worked."""
        from core_rasterizer import open_device
        from registry.discovery import Plugins
        from registry.toolkit.networks import OnnxModel
        from registry.toolkit.networks.onnx_model import answers_within

        from .prior_trials import guesses, known_truth
        from .view_counts import fault_of_view_count

        output, plugins = console(), Plugins()
        if arguments.model.suffix in SCRIPTS:
            model = arguments.model
        else:
            model = OnnxModel(arguments.model)
            _print_properties(model, output)
        found = guesses(model, plugins, arguments.set)
        device = open_device(arguments.device)
        with _quiet_priors(), answers_within(LONGEST):
            truth = known_truth(plugins, device)
            trials = list(_successful(found, truth, device, output))
            if not trials:
                output.print("no settings worked")
                return FAULT
            best = min(trials, key=lambda trial: trial.score.error)
            fault = fault_of_view_count(best.prior, model, truth.views, truth.bounds)
        if fault:
            output.print(f"\nnot usable with other numbers of views: {fault}")
            return FAULT
        _print_best(best, output)
        return 0


@contextmanager
def _quiet_priors() -> Iterator[None]:
    """Suppress the priors' own log lines about their duration."""
    log = logging.getLogger("stereogs.priors")
    before = log.level
    log.setLevel(logging.WARNING)
    try:
        yield
    finally:
        log.setLevel(before)


def _print_properties(model: OnnxModel, output: Console) -> None:
    output.print(f"{model.path}\n  SHA-256  {model.sha256}")
    output.print(f"  run on   {model.provider}, {model.threads} threads")
    for kind, specs in (("input", model.inputs), ("output", model.outputs)):
        for spec in specs:
            output.print(f"  {kind:<7}  {spec}")


def _successful(
    found: Iterable[Guess], truth: Truth, device: Device, output: Console
) -> Iterable[Trial]:
    """Yield the trials that worked, and print a line per trial."""
    from core_rasterizer import ExplainedError

    from .prior_trials import attempt

    for guess in found:
        shown = (f"{k}={v}" for k, v in guess.settings.items() if k not in ("model", "sha256"))
        label = " ".join([guess.offer.name, *shown])
        try:
            trial = attempt(guess, truth, device)
        except ExplainedError as error:
            output.print(f"{label}: failed: {error.what}")
            continue
        output.print(f"{label}: error {trial.score.error:.3f}, {trial.seconds:.2f} s")
        yield trial


def _print_best(best: Trial, output: Console) -> None:
    from registry.system.memory import peak_memory_mb

    output.print(f"\nbest: {best.score.text}")
    memory = peak_memory_mb()
    at_most = "" if memory is None else f"; memory of this process at most {memory:.0f} MB"
    output.print(f"{best.seconds:.2f} s{at_most}\n")
    output.print(best.guess.to_yaml())
