"""`ray`: train on the machines of a Ray cluster (extra `cluster`).

A worker receives the pipeline as text, runs `stereogs train` in a temporary folder, and returns the run
folder as an archive. The archive is extracted atomically; the task of a lost worker is retried on another.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic import Field

from registry import Context, PluginError, Register, Settings, hookimpl
from registry.runners import Runner, RunningTask
from registry.toolkit import optional_module

if TYPE_CHECKING:
    from registry.runners import TrainingTask

_PASSED_ON = ("STEREOGS_DATA", "STEREOGS_MODELS", "STEREOGS_DEVICE", "STEREOGS_PLUGINS")
"""Environment variables passed to workers; folders must have the same path on all machines."""
_RUN = "run"


class RayClusterSettings(Settings):
    address: str | None = None
    """Address for `ray.init`; "auto" finds a running cluster; null starts one on this machine."""
    cores: float = Field(2, gt=0, allow_inf_nan=False)
    """CPU cores reserved per training."""
    gpus: float = Field(0, ge=0, allow_inf_nan=False)
    """GPUs reserved per training."""
    retries: int = Field(3, ge=0)
    """Number of retries of a task whose worker is lost."""


class Archive(NamedTuple):
    """Result of a worker.

    Args:
        status: exit status of `stereogs`.
        printed: its output.
        run: the run folder as a tar archive.
    """

    status: int
    printed: str
    run: bytes


class RayCluster(Runner[RayClusterSettings]):
    """Trainings as tasks of a Ray cluster, which decides how many run concurrently.

    Every machine needs the same version of this package, the plugins used by the pipelines, and the data
    at the same paths.

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
        self._train = ray.remote(
            num_cpus=settings.cores, num_gpus=settings.gpus, max_retries=settings.retries
        )(train)

    def start(self, task: TrainingTask) -> RunningTask:
        """Submit a task to the cluster."""
        environment = {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
        return _RayTask(
            self._ray, self._train.remote(task.pipeline, task.device, environment), task
        )

    def close(self) -> None:
        """Disconnect from the cluster, if this runner connected to it."""
        if self._joined:
            self._ray.shutdown()


class _RayTask(RunningTask):
    """A task in the cluster; `failure` extracts its result."""

    def __init__(self, ray: Any, result: Any, task: TrainingTask) -> None:
        self._ray, self._result, self._task = ray, result, task

    @property
    def ended(self) -> bool:
        ready, _ = self._ray.wait([self._result], timeout=0)
        return bool(ready)

    def failure(self) -> str:
        try:
            archive: Archive = self._ray.get(self._result)
        except self._ray.exceptions.RayError as error:
            return f"the task failed in the cluster: {str(error).splitlines()[0]}"
        self._task.log.write_text(archive.printed, "utf-8")
        if archive.status:
            lines = [line for line in archive.printed.splitlines() if line.strip()]
            return "\n".join(lines[-3:]) or f"exit status {archive.status}"
        extract(archive.run, self._task.folder)
        return ""

    def stop(self) -> None:
        self._ray.cancel(self._result)

    def kill(self) -> None:
        self._ray.cancel(self._result, force=True)


def train(pipeline: str, device: str | None, environment: dict[str, str]) -> Archive:
    """Train a pipeline in a temporary folder; runs on a worker."""
    with tempfile.TemporaryDirectory(prefix="stereogs-") as name:
        folder = Path(name)
        (folder / "pipeline.yaml").write_text(pipeline, "utf-8")
        command = [sys.executable, "-m", "stereogs", "train", str(folder / "pipeline.yaml")]
        command += ["--out", str(folder / _RUN)]
        command += [] if device is None else ["--device", device]
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env={**os.environ, **environment},
            check=False,
        )
        printed = done.stdout.decode("utf-8", errors="replace")
        archive = io.BytesIO()
        with tarfile.open(fileobj=archive, mode="w") as file:
            if (folder / _RUN).is_dir():
                file.add(folder / _RUN, arcname=_RUN)
        return Archive(done.returncode, printed, archive.getvalue())


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
