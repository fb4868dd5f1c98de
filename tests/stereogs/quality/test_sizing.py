"""The working size of photographs: from the time, from the memory, or as it is given."""

from __future__ import annotations

from pathlib import Path
from time import monotonic

import pytest

import stereogs.quality.sizing as sizing
from core_rasterizer import Device
from registry import RunError, Scene
from stereogs import Pipeline, load_scene, train
from stereogs.quality.fitting import Fit
from stereogs.quality.within_seconds import Budget, WithinSeconds
from tests.host import Plugins, load_pipeline
from tests.stereogs_plugins.scenes.small_scenes import World, write_llff

WIDTH = 640


@pytest.fixture(autouse=True)
def _no_installed_plugins() -> None:
    """The installed plugins are used here."""


@pytest.fixture(scope="module")
def pipeline(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """A pipeline with three training and two test views of 640x480 pixels."""
    folder = write_llff(tmp_path_factory.mktemp("llff"), World(width=WIDTH, height=480))
    scene = [f"scene.path={folder}", "scene.downsample=2"]
    small = ["initializer=sfm", "priors=[]", "training.iterations=2", "modifiers=[]"]
    return load_pipeline(Path("3dgs_fast"), Plugins(), overrides=[*scene, *small])


@pytest.fixture(scope="module")
def scene(pipeline: Pipeline) -> Scene:
    return load_scene(pipeline)


def size_for(scene: Scene, seconds: float | None, device: Device) -> int:
    found = sizing.smaller_size(scene, seconds, device)
    return WIDTH if found is None else found.pixels


def test_the_size_follows_from_the_time(
    scene: Scene, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sizing, "sweep_seconds", lambda device: 0.01)
    monkeypatch.setattr(sizing, "available_bytes", lambda: float("inf"))
    needed = 0.01 * sizing.SWEEPS * 3 * WIDTH * 480 / 1e6
    assert size_for(scene, None, device) == WIDTH
    assert size_for(scene, 2.1 * needed, device) == WIDTH
    assert size_for(scene, needed, device) == pytest.approx(WIDTH / 2**0.5, abs=1)
    assert size_for(scene, -1.0, device) == sizing.SMALLEST


def test_the_size_follows_from_the_memory(
    scene: Scene, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sizing, "available_bytes", lambda: 0.5e9)
    pixels = WIDTH * 480
    needed = sizing.BYTES_PER_PIXEL * pixels + sizing.BYTES_PER_VIEW_PIXEL * 5 * pixels
    found = sizing.smaller_size(scene, None, device)
    assert found is not None
    assert found.reason == "memory"
    assert found.pixels == pytest.approx(WIDTH * (0.25e9 / needed) ** 0.5, abs=1)


def test_a_machine_is_measured(device: Device) -> None:
    assert 0 < sizing.sweep_seconds(device) < 10


def test_photographs_are_read_again_at_the_chosen_size(
    pipeline: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    budget = Budget(1e-3, monotonic() - 1)
    run = train(
        pipeline, fit=WithinSeconds(said.append, adapts_size=True, budget=budget), progress=False
    )
    assert run.scene.train[0].camera.width == sizing.SMALLEST
    assert f"max_size: {sizing.SMALLEST}\n" in run.pipeline_text
    assert said[0] == "photographs: 256 pixels instead of 640: time is short"
    again = train(run.pipeline, progress=False)
    assert (again.hash, again.iteration) == (run.hash, 2)


def test_a_given_size_is_kept(pipeline: Pipeline, scene: Scene) -> None:
    said: list[str] = []
    assert Fit(said.append, size=1000).resized(pipeline, scene) is pipeline
    assert said == ["the photographs have 640 pixels and are not enlarged"]


def test_a_protocol_fixes_the_size(scene: Scene) -> None:
    protocol = load_pipeline(
        Path("3dgs_fast"), Plugins(), overrides=["protocol=llff-3", "scene.path=here"]
    )
    with pytest.raises(RunError, match="the protocol 'llff-3' fixes the size"):
        Fit(print, size=300).resized(protocol, scene)
