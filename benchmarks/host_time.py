"""CPU time of the main thread per training iteration, without kernels, waits for them, and networks.

    python -m benchmarks.host_time [PIPELINE ...] [--set KEY=VALUE ...]

prints it for the engine alone and for pipelines. On a GPU this time bounds small trainings. It depends on the
machine, so it is also given in multiples of a loop of pure Python (`yardsticks.python_milliseconds`).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

import pyopencl as cl

from benchmarks.engine import Workload
from benchmarks.stage_clock import StageClock
from benchmarks.trainings import PIPELINES
from benchmarks.yardsticks import python_milliseconds
from core_rasterizer import Device, open_device
from registry.pipeline.pipeline import Pipeline
from registry.toolkit.networks import OnnxModel
from registry.training.trainer import Trainer
from stereogs.experiments.showing.score_table import markdown
from stereogs.session import build_pipeline, train

ITERATION, LEFT_OUT = "iteration", "waits and networks"


def pipeline_host_ms(pipeline: Pipeline, device: Device) -> float:
    """Return host milliseconds per iteration, the mean over a whole training.

    The pipeline is trained twice: the first training builds kernels.
    """
    train(pipeline, device=device, progress=False)
    with host_clock() as clock, _wrapped(clock, (Trainer, "_iterate", ITERATION)):
        run = train(pipeline, device=device, progress=False)
    return 1e3 * clock.finish()[ITERATION][1] / run.iteration


def engine_host_ms(workload: Workload, repeats: int = 60) -> float:
    """Return host milliseconds per iteration of the engine alone."""
    workload.iteration()
    with host_clock() as clock, clock.stage(ITERATION):
        for _ in range(repeats):
            workload.iteration()
    return 1e3 * clock.finish()[ITERATION][1] / repeats


@contextmanager
def host_clock() -> Iterator[StageClock]:
    """Count CPU seconds of this thread; waits for the device and networks are a stage of their own.

    A driver may wait in a loop that takes CPU time.
    """
    clock = StageClock(time.monotonic(), time.thread_time)
    copy = cl.enqueue_copy

    def copied(*arguments: Any, **options: Any) -> Any:
        if not options.get("is_blocking", True):
            return copy(*arguments, **options)
        with clock.stage(LEFT_OUT):
            return copy(*arguments, **options)

    waits = ((cl.CommandQueue, "finish"), (cl.Event, "wait"), (OnnxModel, "run"))
    with (
        patch.object(cl, "enqueue_copy", copied),
        _wrapped(clock, *((owner, name, LEFT_OUT) for owner, name in waits)),
    ):
        yield clock


@contextmanager
def _wrapped(clock: StageClock, *stages: tuple[Any, str, str]) -> Iterator[None]:
    """Count functions as stages within a block."""
    with ExitStack() as restored:
        for owner, name, stage in stages:
            restored.callback(setattr, owner, name, getattr(owner, name))
            clock.wrap(owner, name, stage)
        yield


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pipelines", nargs="*", default=["weightfree_fast", "3dgs_fast"])
    parser.add_argument("--set", action="append", default=["training.iterations=300"])
    arguments, device = parser.parse_args(), open_device()
    found = {"engine alone": engine_host_ms(Workload(10_000, device))}
    for name in arguments.pipelines:
        pipeline = build_pipeline(PIPELINES / f"{name}.yaml", arguments.set)
        found[name] = pipeline_host_ms(pipeline, device)
    loop = python_milliseconds()
    rows = [[name, f"{ms:.2f}", f"{ms / loop:.2f}"] for name, ms in found.items()]
    print(markdown(["host time per iteration", "ms", "loops of Python"], rows))


if __name__ == "__main__":
    main()
