"""Published networks compared with the ground truth, if STEREOGS_MODELS has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import stereogs
from stereogs_plugins.priors.onnx_mvs import OnnxMvs
from stereogs_plugins.priors.onnx_stereo import OnnxStereo
from stereogs_plugins.scenes.llff import LLFFScene
from tests.data import data_folder, models_folder
from tests.host import load_pair, point_errors, reconstructed, stereo_score
from tests.stereogs_plugins.building import build

pytestmark = pytest.mark.proof
PIPELINES = Path(__file__).parents[3] / "pipelines"


def test_hitnet_on_cones() -> None:
    model = models_folder("hitnet_eth3d") / "hitnet_eth3d.onnx"
    pair = load_pair(data_folder("stereo_cones"))
    prior = build(OnnxStereo, model=model, max_disparity=128.0)
    assert stereo_score(prior.disparity(pair.left, pair.right), pair).bad_2 <= 5


def test_itermvs_on_a_view_of_fern() -> None:
    """Shares of the points of COLMAP whose depth is right within 3 %: of all, and where it is sure."""
    model = models_folder("itermvs") / "itermvs_blendedmvs.onnx"
    folder = data_folder("llff_fern")
    scene = build(LLFFScene, path=folder, train_views=3).load()
    prior = build(OnnxMvs, model=model, size=(512, 384))
    seen = reconstructed(folder / "points3d.npz", scene)
    *others, view = scene.train
    answer = prior.depth_of(view, scene.train, scene.bounds)
    unknown = [torch.zeros_like(answer.depth) for _ in others]
    sure = torch.where(answer.confidence >= 0.3, answer.depth, 0.0)
    for depth, least in ((answer.depth, 0.80), (sure, 0.95)):
        errors = point_errors(scene, seen, [map_.numpy() for map_ in (*unknown, depth)])
        known = errors[np.isfinite(errors)]
        assert len(known) > 100
        assert (known < 0.03).mean() >= least


@pytest.mark.parametrize("name", ["stereogs_short", "with_networks"])
def test_pipelines_with_networks_train_on_the_procedural_room(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEREOGS_MODELS", str(models_folder("hitnet_eth3d").parent))
    monkeypatch.setenv("STEREOGS_DATA", "unused")
    changes = [
        "scene={use: procedural, width: 192, height: 144, test_views: 1}",
        "training.iterations=12",
        "metrics=[psnr]",
        "exporters=[]",
        "reports=[]",
        "regularizers.stereo_depth.start=4",
    ]
    pipeline = stereogs.build_pipeline(PIPELINES / f"{name}.yaml", changes)
    pulled: list[float] = []

    def remember(done: stereogs.Iteration) -> None:
        pulled.extend(v for k, v in done.logged.items() if k == "regularizers.stereo_depth")

    run = stereogs.train(pipeline, progress=False, callback=remember)
    assert len(pulled) == 9
    assert all(np.isfinite(pulled))
    assert max(pulled) > 0
    psnr = run.scores["test"].mean["psnr"]
    assert psnr is not None
    assert np.isfinite(psnr)
