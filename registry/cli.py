"""The `stereogs` command."""

from __future__ import annotations

import argparse
import logging
import os
import sys
import traceback
from collections.abc import Sequence

import torch

from core_rasterizer import ExplainedError

from .commands import ablate, check, compare, demo, doctor, evaluate, plugins, render, train
from .commands.output import error_console

USAGE_ERROR = 2
INTERRUPTED = 130
TRACE = "STEREOGS_TRACE"
"""Environment variable: 1 shows the Python traceback of every error."""

PROGRESS = "stereogs"
"""Logger whose INFO lines are shown: a component that takes long tells of it there."""

_EPILOG = """\
examples:
  stereogs demo                               three photographs to a scored scene, in minutes
  stereogs check FOLDER                       what is in a folder of photographs or data
  stereogs train pipelines/3dgs.yaml --set scene.path=FOLDER
  stereogs eval runs/3dgs-fern
  stereogs compare runs/3dgs-fern runs/stereogs-fern
  stereogs render runs/3dgs-fern --path
  stereogs ablate pipelines/ablations/parts.yaml
  stereogs plugins                            what a pipeline can name

environment:
  STEREOGS_DATA      folder of data sets that the ready pipelines read
  STEREOGS_MODELS    folder of model files that the ready pipelines read
  STEREOGS_CACHE     where answers of priors and found cameras are kept; empty = nowhere
  STEREOGS_CACHE_MB  how many megabytes are kept there; unset = 5000
  STEREOGS_DEVICE    part of the name of the OpenCL device to use
  STEREOGS_PLUGINS   plugins to load: unset = all, empty = none, or names by commas
  STEREOGS_TRACE     1 = show the Python traceback of errors
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status.

    0 done; 1 a check found a fault; 2 something is wrong and was explained; 130 after Ctrl-C.
    """
    parsed = build_parser().parse_args(arguments)
    # torch's own threads would wait in a spin beside the OpenCL device's: small operations between
    # kernels then cost milliseconds. One thread also makes torch's sums independent of the machine.
    torch.set_num_threads(1)
    logging.basicConfig(level=logging.WARNING, format="stereogs: %(message)s")
    logging.getLogger(PROGRESS).setLevel(logging.INFO)
    try:
        status: int = parsed.run(parsed)
    except ExplainedError as error:
        return _explain(error)
    except OSError as error:
        where = str(error.filename or "")
        what = f"a file operation failed: {error.strerror or error}"
        return _explain(ExplainedError(what, where=where, fix="check the path and the free space"))
    except KeyboardInterrupt:
        error_console().print("stereogs: interrupted")
        return INTERRUPTED
    return status


def build_parser() -> argparse.ArgumentParser:
    """The whole command line, verb by verb."""
    parser = argparse.ArgumentParser(
        prog="stereogs",
        description="Three to twenty-four photographs become a 3D Gaussian scene.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verbs = parser.add_subparsers(title="verbs", metavar="VERB", required=True)
    for verb in (check, train, evaluate, render, compare, ablate, plugins, doctor, demo):
        verb.add(verbs)
    return parser


def _explain(error: ExplainedError) -> int:
    if os.environ.get(TRACE) == "1":
        traceback.print_exception(error)
    console = error_console()
    console.print(f"stereogs: {error.what}")
    for label, text in (("where", error.where), ("fix", error.fix)):
        if text:
            indented = text.replace("\n", "\n" + " " * 9)
            console.print(f"  {label:<6} {indented}")
    return USAGE_ERROR


if __name__ == "__main__":
    sys.exit(main())
