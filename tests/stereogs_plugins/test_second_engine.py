"""Training knows an engine only by its protocol: another one trains to nearly the same scores."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import stereogs
from core_rasterizer import Engine, GaussianModel, open_device
from stereogs import Run
from tests.torch_engine import TorchEngine, TorchModel

PIPELINE = """\
name: two_engines
scene: {use: procedural, width: 32, height: 24, train_views: 3, test_views: 1}
initializer: {use: random, count: 150}
modifiers: [{use: dropout, rate: 0.1}]
densification: {use: gradient_threshold, gradient_threshold: 0.003, start: 10, stop: 30, every: 10}
opacity: {use: opacity_reset, start: 25, stop: 26, every: 25}
metrics: [psnr]
training: {iterations: 60, sh_degree: 1, sh_every: 20, checkpoint_every: 30, max_gaussians: 1000}
"""
TOLERANCE = 0.25
"""dB, between scores after 60 iterations; rounding differs, and with it which Gaussians grow."""


def trained(folder: Path, device: Engine | None = None) -> Run:
    """Train; mypy checks at the calls that an engine has the protocol."""
    return stereogs.train(PIPELINE, out=folder, device=device, progress=False)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Run]:
    """The same training by the OpenCL engine and by plain torch."""
    folder = tmp_path_factory.mktemp("engines")
    return trained(folder / "opencl"), trained(folder / "torch", TorchEngine(open_device()))


def score(run: Run) -> float:
    assert run.folder is not None
    return float(stereogs.results(run.folder.path)["test"]["psnr"])


def test_both_engines_reach_the_same_score(runs: tuple[Run, Run]) -> None:
    opencl, torch = runs
    assert isinstance(opencl.engine_model, GaussianModel)
    assert isinstance(torch.engine_model, TorchModel)
    assert opencl.model.count > 150
    assert abs(opencl.model.count - torch.model.count) <= 5
    assert score(torch) == pytest.approx(score(opencl), abs=TOLERANCE)


def test_provenance_names_the_engine(runs: tuple[Run, Run]) -> None:
    for run, name in zip(runs, ("opencl", "torch"), strict=True):
        assert run.folder is not None
        provenance = json.loads((run.folder.path / "provenance.json").read_text())
        assert provenance["engine"] == name
        assert provenance["device"]["name"] == open_device().name


def test_a_run_is_opened_and_rendered_in_another_engine(runs: tuple[Run, Run]) -> None:
    """The folder holds Gaussians, of whatever engine."""
    opencl, torch = runs
    assert torch.folder is not None
    opened = stereogs.open_run(torch.folder.path)
    assert isinstance(opened.engine_model, GaussianModel)
    camera = torch.scene.train[0].camera
    pictures = [stereogs.render(run, camera) for run in (opened, torch)]
    assert abs(pictures[0].rgb - pictures[1].rgb).max() < 1e-4
    assert opencl.model.digest() != torch.model.digest()
