"""`ray`: train on the machines of a Ray cluster (extra `cluster`).

Where a worker sees the run folder, it trains there, and a task that is retried after the loss of its worker
resumes from the last checkpoint. Elsewhere it trains in a temporary folder, which returns as an archive.
"""

from __future__ import annotations

import asyncio
import io
import itertools
import json
import os
import subprocess
import sys
import tarfile
import tempfile
import time
import uuid
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml
from pydantic import Field

from registry import Context, PluginError, Register, Settings, hookimpl
from registry.runners import DATA_MISSING, WORKER, Runner, RunningTask, failure
from registry.toolkit import optional_module

if TYPE_CHECKING:
    from registry.runners import TrainingTask

_PASSED_ON = ("STEREOGS_DATA", "STEREOGS_MODELS", "STEREOGS_DEVICE", "STEREOGS_PLUGINS")
"""Environment variables passed to workers; folders must have the same path on all machines."""
_RUN = "run"
_POLL_SECONDS = 0.5


class RayClusterSettings(Settings):
    address: str | None = None
    """Address for `ray.init`; "auto" finds a running cluster; null starts one on this machine."""
    cores: float = Field(2, gt=0, allow_inf_nan=False)
    """CPU cores reserved per training."""
    gpus: float = Field(0, ge=0, allow_inf_nan=False)
    """GPUs reserved per training."""
    memory_mb: float = Field(2000, ge=0, allow_inf_nan=False)
    """Memory reserved per training: Ray starts it where so much is left, but does not enforce it."""
    retries: int = Field(3, ge=0)
    """Number of retries of a task whose worker is lost."""


class Job(NamedTuple):
    """What a worker needs.

    Args:
        name: of the run folder.
        pipeline: a file that holds `text` where the run folder is shared.
        text: the pipeline.
        run: the run folder.
        log: the log next to it.
        device: as for `--device`.
        environment: variables to set.
        stopped: archive of a stopped run, which is resumed where the folder is not shared; or empty.
    """

    name: str
    pipeline: Path
    text: str
    run: Path
    log: Path
    device: str | None
    environment: dict[str, str]
    stopped: bytes


class Ended(NamedTuple):
    """How a training ended.

    Args:
        status: its exit status.
        node: the machine, as Ray names it.
        printed: its output, where the folder is not shared.
        run: the run folder as a tar archive, where it is not shared.
    """

    status: int
    node: str
    printed: str = ""
    run: bytes = b""


class Board:
    """An actor that tells the driver how far each task is, and each task when to stop."""

    def __init__(self) -> None:
        self._shares: dict[str, float] = {}
        self._stops: dict[str, asyncio.Event] = {}

    def _stop(self, name: str) -> asyncio.Event:
        return self._stops.setdefault(name, asyncio.Event())

    async def report(self, name: str, share: float) -> None:
        """Note the finished share of a task."""
        self._shares[name] = share

    async def share(self, name: str) -> float:
        """Return the finished share of a task."""
        return self._shares.get(name, 0.0)

    async def stop(self, name: str) -> None:
        """Let `stopped` return."""
        self._stop(name).set()

    async def stopped(self, name: str) -> None:
        """Wait until the task shall stop."""
        await self._stop(name).wait()


class RayCluster(Runner[RayClusterSettings]):
    """Trainings as tasks of a Ray cluster, which decides how many run concurrently.

    Every machine needs the same version of this package, the plugins used by the pipelines, and the data
    at the same paths. A task whose data is missing on a machine is sent to another.

    Raises:
        PluginError: Ray is not installed, or the cluster cannot be reached.
    """

    def __init__(self, settings: RayClusterSettings, context: Context) -> None:
        super().__init__(settings, context)
        ray = optional_module("ray", "pip install 'stereogs-plugins[cluster]'", then="")
        self._ray = ray
        self._joined = not ray.is_initialized()
        if self._joined:
            try:
                ray.init(settings.address, log_to_driver=False, include_dashboard=False)
            except (ConnectionError, RuntimeError, ValueError) as error:
                raise PluginError(
                    f"cannot connect to the cluster at {settings.address}: {error}",
                    fix="start one with `ray start --head`, or omit `address`",
                ) from error
        # Ray schedules a training only where cores, GPUs and memory are left.
        self._train = ray.remote(
            num_cpus=settings.cores,
            num_gpus=settings.gpus,
            memory=int(settings.memory_mb * 1e6),
            max_retries=settings.retries,
        )(train)
        here = ray.get_runtime_context().get_node_id()
        self._board = ray.remote(num_cpus=0)(Board).options(scheduling_strategy=_on(here)).remote()
        self._turn = itertools.count()

    def start(self, task: TrainingTask) -> RunningTask:
        """Submit a task to the cluster."""
        environment = {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
        # Only a worker that sees this folder, not one like it, finds the number.
        text = f"# {uuid.uuid4().hex}\n{task.pipeline}"
        pipeline = task.folder.absolute().with_name(f"{task.folder.name}.yaml")
        pipeline.write_text(text, "utf-8")
        job = Job(
            task.folder.name,
            pipeline,
            text,
            task.folder.absolute(),
            task.log.absolute(),
            task.device,
            environment,
            packed(task.folder),
        )
        return _RayTask(self, job, task)

    def submit(self, job: Job, without: set[str]) -> Any:
        """Submit a job to a machine outside `without`; return None if no other machine is suitable."""
        if not without:
            return self._train.remote(job, self._board)
        others = [node for node in self._suitable() if node not in without]
        if not others:
            return None
        chosen = others[next(self._turn) % len(others)]
        there = self._train.options(scheduling_strategy=_on(chosen, soft=True))
        return there.remote(job, self._board)

    def _suitable(self) -> list[str]:
        """Return the machines that have the resources of a training."""
        asked = self.settings
        needed = {"CPU": asked.cores, "GPU": asked.gpus, "memory": asked.memory_mb * 1e6}
        return [
            node["NodeID"]
            for node in self._ray.nodes()
            if node["Alive"] and all(node["Resources"].get(k, 0) >= v for k, v in needed.items())
        ]

    def close(self) -> None:
        """Disconnect from the cluster, if this runner connected to it."""
        self._ray.kill(self._board)
        if self._joined:
            self._ray.shutdown()


def _on(node: str, *, soft: bool = False) -> Any:
    """Return the strategy that places a task on a machine; if `soft`, elsewhere after the machine's end."""
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    return NodeAffinitySchedulingStrategy(node, soft=soft)


class _RayTask(RunningTask):
    """A task in the cluster; `ended` receives its result."""

    def __init__(self, runner: RayCluster, job: Job, task: TrainingTask) -> None:
        self._runner, self._ray, self._board = runner, runner._ray, runner._board
        self._job, self._task = job, task
        self._result = runner.submit(job, set())
        self._without: set[str] = set()
        self._end: Ended | str | None = None
        self._share: Any = None
        self._known = 0.0

    @property
    def ended(self) -> bool:
        if self._end is None and self._is_ready(self._result):
            self._end = self._received()
            if isinstance(self._end, Ended) and self._end.status == DATA_MISSING:
                self._without.add(self._end.node)
                other = self._runner.submit(self._job, self._without)
                if other is not None:
                    self._result, self._end = other, None
        return self._end is not None

    def _is_ready(self, reference: Any) -> bool:
        return bool(self._ray.wait([reference], timeout=0)[0])

    def _received(self) -> Ended | str:
        try:
            end: Ended = self._ray.get(self._result)
        except self._ray.exceptions.RayError as error:
            return f"the task failed in the cluster: {str(error).splitlines()[0]}"
        if end.printed:
            self._task.log.write_text(end.printed, "utf-8")
        if end.run:
            extract(end.run, self._task.folder)
        return end

    @property
    def data_missing(self) -> bool:
        return isinstance(self._end, Ended) and self._end.status == DATA_MISSING

    def failure(self) -> str:
        if not isinstance(self._end, Ended):
            return str(self._end)
        return failure(self._end.status, self._task.log.read_text("utf-8", errors="replace"))

    def progress(self) -> float:
        if self._share is None:
            self._share = self._board.share.remote(self._job.name)
        elif self._is_ready(self._share):
            self._known = self._ray.get(self._share)
            self._share = None
        return self._known

    def stop(self) -> None:
        self._board.stop.remote(self._job.name)

    def kill(self) -> None:
        self._ray.cancel(self._result, force=True)


def train(job: Job, board: Any) -> Ended:
    """Train a job; runs on a worker."""
    import ray

    node = ray.get_runtime_context().get_node_id()
    if _is_shared(job):
        return Ended(_followed(job, board), node)
    with tempfile.TemporaryDirectory(prefix="stereogs-") as name:
        folder = Path(name)
        here = job._replace(
            pipeline=folder / "pipeline.yaml", run=folder / _RUN, log=folder / "log"
        )
        here.pipeline.write_text(job.text, "utf-8")
        if job.stopped:
            extract(job.stopped, here.run)
        status = _followed(here, board)
        printed = here.log.read_text("utf-8", errors="replace")
        return Ended(status, node, printed, packed(here.run))


def _is_shared(job: Job) -> bool:
    """Return whether this machine sees the folder of the driver."""
    try:
        return job.pipeline.read_text("utf-8") == job.text
    except OSError:
        return False


def _followed(job: Job, board: Any) -> int:
    """Train in a process, report how far it is, and stop it when the driver stops; return its exit status."""
    import ray

    command = [sys.executable, "-m", WORKER, str(job.pipeline), str(job.run)]
    command += [] if job.device is None else ["--device", job.device]
    with job.log.open("wb") as log:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, **job.environment},
            start_new_session=True,
        )
    stop, asked = board.stopped.remote(job.name), False
    while process.poll() is None:
        # Without waiting: a task that waits for Ray lends its cores to another.
        if not asked and ray.wait([stop], timeout=0)[0]:
            process.terminate()  # processes of Ray block SIGINT
            asked = True
        board.report.remote(job.name, _share(job.run))
        time.sleep(_POLL_SECONDS)
    return process.returncode


def _share(run: Path) -> float:
    """Return the finished share of the iterations of a run; 0 if unknown."""
    try:
        last = (run / "metrics.jsonl").read_text("utf-8").splitlines()[-1]
        settings = yaml.safe_load((run / "pipeline.yaml").read_text("utf-8"))["training"]
        return float(json.loads(last)["iteration"] / settings["iterations"])
    except (OSError, ValueError, KeyError, IndexError, TypeError, ZeroDivisionError):
        return 0.0


def packed(run: Path) -> bytes:
    """Return a folder as an archive; empty if there is none."""
    if not run.is_dir():
        return b""
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as file:
        file.add(run, arcname=_RUN)
    return archive.getvalue()


def extract(archive: bytes, folder: Path) -> None:
    """Extract an archived run folder atomically, replacing `folder` if it exists."""
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".extracting-") as name:
        with tarfile.open(fileobj=io.BytesIO(archive)) as file:
            file.extractall(name, filter="data")
        extracted = (Path(name) / _RUN).resolve(strict=True)
        if folder.exists():
            folder.replace(Path(name) / "replaced")
        extracted.replace(folder)


@hookimpl
def stereogs_register_runners(register: Register[RayCluster]) -> None:
    register("ray", RayCluster)
