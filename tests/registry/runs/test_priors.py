"""A run constructs each prior once, and starts only if it has the priors that its components need."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

import registry as r
import stereogs
from registry import PluginError
from registry.testing import tiny_scene
from tests.host import main
from tests.registry.conftest import TOY_ENTRIES, Install
from tests.registry.toy_plugin import ToyPrior, ToyScene, ToyTerm

PIPELINE = {
    "name": "toy",
    "initializer": "toy_points",
    "priors": ["toy_prior"],
    "regularizers": ["toy_term"],
    "densification": {"use": "toy_growth", "every": 5},
    "metrics": ["psnr"],
    "exporters": ["toy_files", "ply"],
    "training": {"iterations": 60, "sh_degree": 0, "max_gaussians": 90},
}
SHIPPED = "exporters.ply,stereo_depth,patch_depth,sgm,plane_sweep,onnx_stereo"
STEREO = {"use": "stereo_depth", "start": 20_001}
LENGTH = {"iterations": 20_010, "sh_degree": 0}


@pytest.fixture
def constructed(install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The name of each prior that was constructed; the priors draw random numbers during use."""
    install("toys", "1.5", TOY_ENTRIES)
    monkeypatch.setenv("STEREOGS_PLUGINS", f"{os.environ['STEREOGS_PLUGINS']},{SHIPPED}")
    monkeypatch.chdir(tmp_path)
    names: list[str] = []
    construct, loss = ToyPrior.__init__, ToyTerm.loss

    def counted(self: ToyPrior, settings: r.Settings, context: r.Context) -> None:
        names.append(context.name)
        construct(self, settings, context)

    def drawing(self: ToyTerm, step: r.Step) -> Tensor:
        draw = torch.rand((), generator=step.priors["toy_prior"].generator)
        return loss(self, step) * draw

    monkeypatch.setattr(ToyPrior, "__init__", counted)
    monkeypatch.setattr(ToyTerm, "loss", drawing)
    return names


def trained(**more: Any) -> stereogs.Run:
    return stereogs.train(PIPELINE, scene=tiny_scene(), progress=False, **more)


def test_a_training_constructs_a_prior_once(constructed: list[str]) -> None:
    trained()
    assert constructed == ["toy_prior"]


def test_a_length_per_view_does_not_construct_again(constructed: list[str]) -> None:
    changed = {**PIPELINE, "training": {**PIPELINE["training"], "iterations": "30 per view"}}  # type: ignore[dict-item]
    run = stereogs.train(changed, scene=tiny_scene(), progress=False)
    assert run.iteration == 60
    assert constructed == ["toy_prior"]


def test_measuring_does_not_construct_again_and_changes_no_bit(constructed: list[str]) -> None:
    run = trained(fit=stereogs.within(600))
    assert constructed == ["toy_prior"]
    assert run.iteration == 60
    assert stereogs.train(run.pipeline, scene=tiny_scene(), progress=False).hash == run.hash


def test_exports_of_a_training_do_not_construct_again(constructed: list[str]) -> None:
    run = trained(out="run")
    assert "exports/scene.ply" in stereogs.results("run")["exports"]
    assert constructed == ["toy_prior"]
    assert run.hash == stereogs.results("run")["hash"]


def test_an_export_constructs_no_prior(constructed: list[str]) -> None:
    stereogs.train({**PIPELINE, "scene": "toy_scene"}, out="run", progress=False)
    constructed.clear()
    again = stereogs.open_run("run")
    (file, _) = stereogs.export(again, "ply", "files")
    assert file.stat().st_size > 1000
    assert main(["export", "run", "--format", "ply"]) == 0
    assert main(["eval", "run"]) == 0
    assert constructed == []


@pytest.fixture
def untouched(constructed: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail if the scene is loaded."""

    def load(self: ToyScene) -> r.Scene:
        raise AssertionError("the scene was loaded")

    monkeypatch.setattr(ToyScene, "load", load)


def refused(priors: list[dict[str, Any]], **change: Any) -> r.PluginError:
    values = {**PIPELINE, "scene": "toy_scene", "priors": priors, "training": LENGTH}
    with pytest.raises(PluginError) as caught:
        stereogs.train({**values, "regularizers": [STEREO], **change}, out="run", progress=False)
    assert not Path("run").exists()
    return caught.value


@pytest.mark.usefixtures("untouched")
def test_a_missing_prior_is_refused_before_training() -> None:
    error = refused([])
    assert error.what == (
        "a prior with the capability 'stereo_disparity' is needed, and the pipeline has none"
    )
    assert "stereo_depth" in error.where
    named = refused([{"use": "sgm"}], regularizers=[{**STEREO, "prior": "other"}])
    assert "no prior named 'other'" in named.what
    assert "sgm (stereo_disparity)" in named.fix


@pytest.mark.usefixtures("untouched")
def test_a_prior_of_another_capability_is_refused_before_training() -> None:
    assert "the pipeline has none" in refused([{"use": "toy_prior"}]).what
    term = {**STEREO, "prior": "toy_prior"}
    named = refused([{"use": "toy_prior"}, {"use": "sgm"}], regularizers=[term])
    assert "'toy_prior' has the capability 'monocular_depth'" in named.what
    two = refused([{"use": "sgm"}, {"use": "sgm", "name": "second"}])
    assert two.what == "2 priors have the capability 'stereo_disparity'"
    assert two.fix == "choose with `prior: NAME`, one of sgm, second"


@pytest.mark.usefixtures("untouched")
def test_either_of_two_capabilities_is_enough() -> None:
    term = {"use": "patch_depth", "form": "hard", "start": 20_001}
    error = refused([], regularizers=[term])
    assert "'monocular_depth' or 'multi_view_depth' is needed" in error.what
    with pytest.raises(PluginError, match="the scene was loaded"):
        stereogs.train(
            {**PIPELINE, "scene": "toy_scene", "priors": ["plane_sweep"], "regularizers": [term]},
            progress=False,
        )


@pytest.mark.usefixtures("untouched")
@pytest.mark.parametrize(
    ("content", "sha256", "what"),
    [
        (None, "0" * 64, "cannot be read: No such file"),
        (b"text", "0" * 64, "has the SHA-256"),
        (b"text", None, "ONNX"),
    ],
)
def test_an_unusable_model_file_is_refused_before_training(
    content: bytes | None, sha256: str | None, what: str
) -> None:
    if content is not None:
        Path("model.onnx").write_bytes(content)
    prior = {"use": "onnx_stereo", "model": "model.onnx", "sha256": sha256}
    error = refused([prior])
    assert what in error.what
    assert "model.onnx" in error.where


def test_a_component_that_is_never_due_needs_no_prior(constructed: list[str]) -> None:
    term = {**STEREO, "weight": 0}
    run = stereogs.train({**PIPELINE, "regularizers": [term]}, scene=tiny_scene(), progress=False)
    assert run.finished


def test_resuming_checks_the_priors_too(
    constructed: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    trained(out="run", callback=lambda done: done.number < 5)
    monkeypatch.setattr(ToyTerm, "needs_priors", ("stereo_disparity",))
    with pytest.raises(PluginError, match="'stereo_disparity' is needed"):
        stereogs.resume("run", scene=tiny_scene(), progress=False)
