"""`ray`: trainings on the machines of a Ray cluster (extra `cluster`).

A task is files in and files out: the worker gets the pipeline's text, trains it with `stereogs train` in
a folder of its own, and its run folder comes back as one archive, which is put into its place when it is
whole. So a result lands once; the task of a worker that is lost is given to another.
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
from registry.plugins import optional_module
from registry.runners import Runner, RunningTask

if TYPE_CHECKING:
    from registry.runners import TrainingTask

_PASSED_ON = ("STEREOGS_DATA", "STEREOGS_MODELS", "STEREOGS_DEVICE", "STEREOGS_PLUGINS")
"""Environment variables that a worker takes from here: folders must have the same path there."""
_RUN = "run"


class RayClusterSettings(Settings):
    address: str | None = None
    """Of the cluster, as for `ray.init`; "auto" finds a running one; null starts one on this machine."""
    cores: float = Field(2, gt=0, allow_inf_nan=False)
    """Processor cores that a training asks the cluster for."""
    gpus: float = Field(0, ge=0, allow_inf_nan=False)
    """GPUs that a training asks the cluster for."""
    retries: int = Field(3, ge=0)
    """How often a task is given to another worker when its own is lost."""


class Archive(NamedTuple):
    """What comes back from a worker.

    Args:
        status: the exit status of `stereogs`.
        printed: what it printed.
        run: the run folder as a tar archive.
    """

    status: int
    printed: str
    run: bytes


class RayCluster(Runner[RayClusterSettings]):
    """Trainings as tasks of a Ray cluster; the cluster decides how many run at the same time.

    Every machine needs this package at the same version, the plugins that the pipelines name, and
    the data at the same paths.

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
                    f"no cluster is reached at {settings.address}: {error}",
                    fix="start one with `ray start --head`, or leave `address` out",
                ) from error
        self._train = ray.remote(
            num_cpus=settings.cores, num_gpus=settings.gpus, max_retries=settings.retries
        )(train)

    def start(self, task: TrainingTask) -> RunningTask:
        """Hand a task to the cluster."""
        environment = {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
        return _RayTask(
            self._ray, self._train.remote(task.pipeline, task.device, environment), task
        )

    def close(self) -> None:
        """Leave the cluster, if it was joined here."""
        if self._joined:
            self._ray.shutdown()


class _RayTask(RunningTask):
    """A task in the cluster; its result is put into its place when it is asked for."""

    def __init__(self, ray: Any, answer: Any, task: TrainingTask) -> None:
        self._ray, self._answer, self._task = ray, answer, task

    @property
    def ended(self) -> bool:
        ready, _ = self._ray.wait([self._answer], timeout=0)
        return bool(ready)

    def failure(self) -> str:
        try:
            archive: Archive = self._ray.get(self._answer)
        except self._ray.exceptions.RayError as error:
            return f"the cluster lost it: {str(error).splitlines()[0]}"
        self._task.log.write_text(archive.printed, "utf-8")
        if archive.status:
            said = [line for line in archive.printed.splitlines() if line.strip()]
            return "\n".join(said[-3:]) or f"exit status {archive.status}"
        land(archive.run, self._task.folder)
        return ""

    def stop(self) -> None:
        self._ray.cancel(self._answer)

    def kill(self) -> None:
        self._ray.cancel(self._answer, force=True)


def train(pipeline: str, device: str | None, environment: dict[str, str]) -> Archive:
    """Train a pipeline in a folder that is gone afterwards; runs on a worker."""
    with tempfile.TemporaryDirectory(prefix="stereogs-") as name:
        folder = Path(name)
        (folder / "pipeline.yaml").write_text(pipeline, "utf-8")
        command = [sys.executable, "-m", "registry", "train", str(folder / "pipeline.yaml")]
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
        return Archive(done.returncode, printed, _packed(folder / _RUN))


def _packed(folder: Path) -> bytes:
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as file:
        if folder.is_dir():
            file.add(folder, arcname=_RUN)
    return archive.getvalue()


def land(archive: bytes, folder: Path) -> None:
    """Put an archived run folder into its place, whole or not at all; what lay there is replaced."""
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".landing-") as name:
        with tarfile.open(fileobj=io.BytesIO(archive)) as file:
            file.extractall(name, filter="data")
        landed = (Path(name) / _RUN).resolve(strict=True)
        if folder.exists():
            folder.replace(Path(name) / "replaced")
        landed.replace(folder)


@hookimpl
def stereogs_register_runners(register: Register[RayCluster]) -> None:
    register("ray", RayCluster)
