"""`submitit` with its executor of this machine: train, stop, resume; data that is missing.

Tests of `stereogs.experiments`, which import its modules.
"""

from __future__ import annotations

import io
import signal
import time
from pathlib import Path

import pytest
from rich.console import Console

from core_rasterizer import Device, open_device
from registry import Context
from stereogs.experiments.planning.plan import PlannedRun
from stereogs.experiments.running.folder import ExperimentFolder
from stereogs.experiments.running.pool import RUNNER, Outcome, PoolProgress, train_all
from stereogs_plugins.runners.submitit_jobs import Submitit, SubmititSettings
from tests.host import SELECTION, HostSettings, Item, Offer, Part, Place, Plugins
from tests.stereogs.experiments.ablating import plan
from tests.stereogs_plugins.scenes.small_scenes import World, write_llff

submitit = pytest.importorskip("submitit", reason="pip install 'stereogs-plugins[slurm]'")
TINY = """\
name: tiny
scene: {use: llff, path: SCENE, downsample: 2}
initializer: {use: random, count: 50}
modifiers: [dropout]
metrics: [psnr]
training: {iterations: 1500, sh_degree: 0, checkpoint_every: 50}
"""


def planned(folder: Path) -> PlannedRun:
    pipeline = folder / "tiny.yaml"
    pipeline.write_text(TINY.replace("SCENE", str(folder / "garden")))
    return plan(pipeline, Plugins(), toggles="dropout").runs[0]


def trained(run: PlannedRun, folder: ExperimentFolder, device: Device) -> Outcome[PlannedRun]:
    """Train with the runner as a plugin offers it."""
    settings = SubmititSettings.model_validate({"cluster": "local", "cores": 1, "minutes": 5})
    runner = Submitit(settings, Context("submitit", 0, device))
    offer = Offer(RUNNER, "submitit", Submitit, "submitit", "a package", "1")
    item = Item("submitit", settings, HostSettings(use="submitit"), offer, Place("a test"))
    console = Console(file=io.StringIO())
    with folder.locked():
        return train_all([run], folder, Part(item, runner), device=device.name, console=console)


@pytest.mark.proof
def test_a_job_is_stopped_and_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SELECTION, "llff,random,dropout,psnr")
    write_llff(tmp_path / "garden", World())
    run, folder, device = planned(tmp_path), ExperimentFolder(tmp_path / "out"), open_device()
    pressed: list[float] = []

    def press(self: PoolProgress, parts: list[float]) -> None:
        if max(parts, default=0.0) > 0.1 and not pressed:
            pressed.append(time.monotonic())
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(PoolProgress, "show", press)
        assert trained(run, folder, device).stopped
    assert time.monotonic() - pressed[0] < 10
    assert folder.results(run) == {}
    assert trained(run, folder, device).failures == {}
    log = folder.task(run).log.read_text("utf-8")
    assert "continuing after iteration" in log
    assert folder.results(run)["iterations"] == 1500


@pytest.mark.proof
def test_missing_data_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It would be sent to another machine, but there is only this one."""
    monkeypatch.setenv(SELECTION, "llff,random,dropout,psnr")
    run, folder, device = planned(tmp_path), ExperimentFolder(tmp_path / "out"), open_device()
    outcome = trained(run, folder, device)
    assert f"not on this machine: {tmp_path / 'garden'}" in outcome.failures[run]
