"""Priors reach scene loaders: named ones that are installed are added, and run once for a run."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

import stereogs
from registry import PluginError
from tests.host import Parts, Plugins, load_pipeline, main
from tests.registry.conftest import TOY_ENTRIES, Install

PLUGIN = """
import torch
from pathlib import Path
from registry import Register, SceneLoader, Settings, hookimpl
from registry.priors import PosedDepth, PosedDepthPrior
from registry.testing import tiny_scene


class PosedSettings(Settings):
    sha256: str = "ab" * 32


class Posed(PosedDepthPrior[PosedSettings]):
    calls = 0

    def estimate(self, images, intrinsics):
        Posed.calls += 1
        ones = torch.ones(24, 32)
        return [PosedDepth(torch.eye(4), 20 * torch.eye(3), ones, ones) for _ in images]


class UnposedSettings(Settings):
    path: Path = Path("nowhere")
    cameras: str | None = None


class Unposed(SceneLoader[UnposedSettings]):
    @classmethod
    def priors_of(cls, settings):
        return {settings.cameras: "posed_depth"} if settings.cameras else {}

    def load(self):
        scene = tiny_scene()
        for prior in self.context.priors(PosedDepthPrior).values():
            prior.posed_depths([view.image for view in scene.train], [None, None])
        return scene


@hookimpl
def stereogs_register_scenes(register):
    register("unposed", Unposed)


@hookimpl
def stereogs_register_priors(register):
    register("posed", Posed)
"""
TEXT = {
    "name": "toy",
    "scene": {"use": "unposed", "cameras": "posed"},
    "initializer": "toy_points",
    "metrics": ["psnr"],
    "exporters": ["ply"],
    "training": {"iterations": 5, "sh_degree": 0},
}


@pytest.fixture(autouse=True)
def _installed(install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install("toys", "1.5", TOY_ENTRIES)
    install("cams", "1.0", {"unposed": "cams", "posed": "cams"}, cams=PLUGIN)
    monkeypatch.setenv("STEREOGS_PLUGINS", f"{os.environ['STEREOGS_PLUGINS']},exporters.ply")
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)


def calls() -> int:
    count: int = sys.modules["cams"].Posed.calls
    return count


def built(**scene: Any) -> stereogs.Pipeline:
    return stereogs.build_pipeline({**TEXT, "scene": {"use": "unposed", **scene}})


def test_a_network_that_a_loader_names_runs_once_for_all_commands() -> None:
    stereogs.train(TEXT, out="run", progress=False)
    assert calls() == 1
    inputs = json.loads(Path("run/inputs.json").read_text())
    assert "the file of priors.posed.sha256" in json.dumps(inputs)
    assert "use: posed" in Path("run/pipeline.yaml").read_text()
    for command in (["eval"], ["export", "--format", "ply"], ["render"], ["resume"]):
        assert main([command[0], "run", *command[1:]]) == 0
    assert calls() == 1


def test_a_run_resumes_with_the_recorded_prior() -> None:
    stereogs.train(TEXT, out="run", progress=False)
    pipeline = load_pipeline(Path("run/pipeline.yaml"), Plugins())
    assert [item.name for item in pipeline.items["priors"]] == ["posed"]
    assert pipeline.to_yaml() == Path("run/pipeline.yaml").read_text()


def test_priors_of_the_pipeline_reach_a_loader_that_names_none(device: Any) -> None:
    stereogs.train({**TEXT, "scene": "unposed"}, progress=False)
    assert calls() == 0
    pipeline = stereogs.build_pipeline(
        {**TEXT, "scene": "unposed", "priors": ["posed", "toy_prior"]}
    )
    parts = Parts(pipeline, device)
    parts.one("scene").call()
    assert calls() == 1
    (prior, _) = parts["priors"]
    known = parts.one("scene").component.context.priors(type(prior.component))
    assert known == {"posed": prior.component}


def test_a_folder_is_loaded_with_a_named_prior(tmp_path: Path) -> None:
    stereogs.load_scene(tmp_path, ["cameras=posed"], format_name="unposed")
    assert calls() == 1


def test_a_name_that_is_unknown_or_of_another_capability_is_refused() -> None:
    with pytest.raises(PluginError, match="the prior 'posd'; did you mean 'posed'"):
        built(cameras="posd")
    with pytest.raises(PluginError, match="'posed_depth' is needed") as other:
        built(cameras="toy_prior")
    assert "'toy_prior' has the capability 'monocular_depth'" in other.value.what
