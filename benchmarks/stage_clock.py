"""A clock of nested stages, and a training run measured by it.

    python -m benchmarks.stage_clock RECORD.json train pipelines/weightfree_fast.yaml ...

runs `stereogs` with the arguments after the first and writes the time of each stage. Functions are wrapped
from outside; the project's code is unchanged.
"""

from __future__ import annotations

import builtins
import functools
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

BORN = "STAGE_CLOCK_BORN"
"""Environment variable with the value of `time.monotonic` just before the process started."""
REST = "everything else"
IMPORTS = "imports"
INTERPRETER = "interpreter"


class StageClock:
    """Seconds of each stage, without the stages inside it.

    CPU seconds are those of all threads while the stage runs, or by `time.thread_time` of the calling one.
    """

    def __init__(self, born: float, cpu_time: Callable[[], float] | None = None) -> None:
        self._cpu_time = cpu_time or time.process_time
        wall, cpu = time.monotonic(), self._cpu_time()
        self.taken: dict[str, list[float]] = {INTERPRETER: [wall - born, cpu]}
        self._open = [REST]
        self._last = (wall, cpu)

    def _charge(self) -> None:
        now = (time.monotonic(), self._cpu_time())
        row = self.taken.setdefault(self._open[-1], [0.0, 0.0])
        for index in range(2):
            row[index] += now[index] - self._last[index]
        self._last = now

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count a block as a stage."""
        self._charge()
        self._open.append(name)
        try:
            yield
        finally:
            self._charge()
            self._open.pop()

    def wrap(
        self, owner: Any, attribute: str, name: str, settle: Callable[[Any], object] | None = None
    ) -> None:
        """Count every call of a function or method as a stage.

        Args:
            settle: Called with the first argument of the call before the stage ends.
        """
        inner: Callable[..., Any] = getattr(owner, attribute)

        @functools.wraps(inner)
        def timed(*arguments: Any, **options: Any) -> Any:
            with self.stage(name):
                result = inner(*arguments, **options)
                if settle is not None:
                    settle(arguments[0])
                return result

        setattr(owner, attribute, timed)

    def wrap_imports(self) -> None:
        """Count every import that is not inside another one, also imports in functions."""
        inner = builtins.__import__

        def timed(name: str, *arguments: Any, **options: Any) -> Any:
            if self._open[-1] == IMPORTS:
                return inner(name, *arguments, **options)
            with self.stage(IMPORTS):
                return inner(name, *arguments, **options)

        builtins.__import__ = timed

    def finish(self) -> dict[str, list[float]]:
        """Return wall and CPU seconds by stage."""
        self._charge()
        return self.taken


def wrap_stages(clock: StageClock) -> None:
    """Count the stages of a training run."""
    from core_rasterizer.device.program import Program
    from registry.priors import MultiViewDepthPrior
    from registry.runs import outputs, preparation, run
    from registry.runs.run import Run
    from registry.training.field import Field
    from stereogs_plugins.initializers.consistency_dense.initializer import ConsistencyDense

    clock.wrap(Program, "__init__", "kernels built or loaded")
    clock.wrap(preparation, "load_scene", "photographs")
    clock.wrap(MultiViewDepthPrior, "depths", "depth prior")
    clock.wrap(ConsistencyDense, "initialize", "points")
    clock.wrap(preparation, "initial_gaussians", "points")
    for method, name in (
        ("begin", "iteration: schedules and samples"),
        ("render", "iteration: modifiers and render"),
        ("differentiate", "iteration: loss and backward pass"),
        ("update_opacities", "iteration: opacity policies"),
        ("change_topology", "iteration: densification"),
        ("step_optimizer", "iteration: Adam"),
        ("perturb", "iteration: perturbations"),
    ):
        # Without this, enqueued work would count for the next stage that waits.
        clock.wrap(Field, method, name, lambda field: field.model.device.finish())
    clock.wrap(Run, "keep_in", "run folder and checkpoints")
    clock.wrap(run, "save_checkpoint", "run folder and checkpoints")
    clock.wrap(outputs, "_write_with_outputs", "results and export")
    clock.wrap(Run, "evaluate", "evaluation")


def main() -> int:
    clock = StageClock(float(os.environ[BORN]))
    clock.wrap_imports()
    from stereogs.cli import main as stereogs

    wrap_stages(clock)
    status = stereogs(sys.argv[2:])
    Path(sys.argv[1]).write_text(json.dumps(clock.finish()))
    return status


if __name__ == "__main__":
    sys.exit(main())
