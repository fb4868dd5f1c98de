"""The sparse-view protocols through the registry of NerfBaselines: `make nerfbaselines`.

Tests of `stereogs.nerfbaselines`, which import its modules.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stereogs
from tests.data import data_folder
from tests.host import load_protocol, protocol_names, protocol_pipeline

nerfbaselines = pytest.importorskip("nerfbaselines")

from nerfbaselines.datasets import download_dataset, load_dataset  # noqa: E402
from nerfbaselines.evaluation import build_evaluation_protocol  # noqa: E402


def prepared(protocol: str, scene: str, folder: Path) -> Path:
    download_dataset(f"external://stereogs-{protocol}/{scene}", str(folder))
    return folder


def test_every_protocol_is_a_dataset() -> None:
    known = nerfbaselines.get_supported_datasets()
    assert {f"stereogs-{name}" for name in protocol_names()} <= set(known)
    for name in protocol_names():
        spec = nerfbaselines.get_dataset_spec(f"stereogs-{name}")
        assert tuple(one["id"] for one in spec["metadata"]["scenes"]) == load_protocol(name).scenes
        assert spec["evaluation_protocol"] == "stereogs"


@pytest.mark.parametrize(
    ("protocol", "folder", "scene"),
    [
        ("llff-3", "llff_fern", "fern"),
        ("llff-6", "llff_fern", "fern"),
        ("dtu-3", "dtu_scan65", "scan65"),
        ("blender-8", "blender_lego", "lego"),
    ],
)
def test_a_dataset_equals_the_scene_of_a_pipeline_with_the_protocol(
    protocol: str, folder: str, scene: str, tmp_path: Path
) -> None:
    expected = stereogs.load_scene(protocol_pipeline(protocol, data_folder(folder)))
    made = prepared(protocol, scene, tmp_path / "made")
    for split, views in (("train", expected.train), ("test", expected.test)):
        dataset = load_dataset(str(made), split, features=frozenset(("color", "points3D_xyz")))
        assert dataset["metadata"]["id"] == f"stereogs-{protocol}"
        assert dataset["metadata"]["evaluation_protocol"] == "stereogs"
        assert len(dataset["images"]) == len(views)
        np.testing.assert_allclose(dataset["cameras"].nears_fars[0], expected.bounds, rtol=1e-6)
        for index, view in enumerate(views):
            image = dataset["images"][index]
            np.testing.assert_allclose(image / 255, view.image.numpy(), atol=0.51 / 255)
            camera = dataset["cameras"][index]
            np.testing.assert_allclose(
                camera.poses, view.camera.camera_to_world[:3].numpy(), atol=1e-5
            )
            lens = (view.camera.fx, view.camera.fy, view.camera.cx, view.camera.cy)
            np.testing.assert_allclose(camera.intrinsics, lens, rtol=1e-6)
            if view.mask is not None:
                assert (dataset["masks"][index] == view.mask.numpy()).all()


def test_scores_use_the_metrics_and_masks_of_the_protocol(tmp_path: Path) -> None:
    """As in a run, pixels outside the mask change neither PSNR nor SSIM."""
    data_folder("dtu_scan65")
    test = load_dataset(str(prepared("dtu-3", "scan65", tmp_path / "made")), "test")
    view: Any = {"images": [test["images"][0]], "masks": [test["masks"][0]]}
    view["metadata"] = test["metadata"]
    protocol = build_evaluation_protocol("stereogs")
    assert protocol.get_name() == "stereogs"
    noise = np.random.default_rng(0).normal(0, 8, view["images"][0].shape)
    noisy = np.clip(view["images"][0] + noise, 0, 255).astype(np.uint8)
    outside = np.where(view["masks"][0][..., None], noisy, 255 - noisy)
    scores, same = (protocol.evaluate({"color": image}, view) for image in (noisy, outside))
    assert scores == same
    inside = view["masks"][0]
    error = (noisy[inside] / 255.0 - view["images"][0][inside] / 255.0) ** 2
    assert scores["psnr"] == pytest.approx(-10 * np.log10(error.mean()), abs=0.01)
    mean = protocol.accumulate_metrics([scores, {**scores, "psnr": scores["psnr"] + 2}])
    assert mean["psnr"] == pytest.approx(scores["psnr"] + 1)


def test_missing_files_and_folders_are_explained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(nerfbaselines.DatasetNotFoundError, match="does not contain views"):
        load_dataset(str(tmp_path), "train")
    monkeypatch.setenv("STEREOGS_DATA", str(tmp_path))
    with pytest.raises(nerfbaselines.DatasetNotFoundError, match="no folder that is named 'fern'"):
        prepared("llff-3", "fern", tmp_path / "made")
    (tmp_path / "llff_fern").mkdir()
    with pytest.raises(
        nerfbaselines.DatasetNotFoundError, match="a folder with the layout of llff, colmap"
    ):
        prepared("llff-3", "fern", tmp_path / "made")
    monkeypatch.delenv("STEREOGS_DATA")
    with pytest.raises(nerfbaselines.DatasetNotFoundError, match="set STEREOGS_DATA"):
        prepared("llff-3", "fern", tmp_path / "made")


def test_settings_from_the_command_line_are_strings() -> None:
    """`--set training.iterations=7` passes the string "7"."""
    from stereogs.nerfbaselines.method import StereoGS

    room = {"name": "room", "scene": {"use": "procedural", "width": 64, "height": 48}}
    scene = stereogs.load_scene({**room, "initializer": "sfm"})
    dataset = nerfbaselines.new_dataset(
        cameras=nerfbaselines.new_cameras(
            poses=np.array(
                [view.camera.camera_to_world[:3].numpy() for view in scene.train], np.float32
            ),
            intrinsics=np.array(
                [[v.camera.fx, v.camera.fy, 32, 24] for v in scene.train], np.float32
            ),
            camera_models=np.zeros(len(scene.train), np.int32),
            image_sizes=np.array([[64, 48]] * len(scene.train), np.int32),
            nears_fars=np.array([scene.bounds] * len(scene.train), np.float32),
        ),
        image_paths=[f"/room/{view.name}.png" for view in scene.train],
        image_paths_root="/room",
        images=[np.uint8(255 * view.image.numpy() + 0.5) for view in scene.train],
        metadata={"color_space": "srgb"},
    )
    texts = {"pipeline": "3dgs", "training.iterations": "7", "initializer": "random"}
    method = StereoGS(train_dataset=dataset, config_overrides=texts)
    assert method.train_iteration(0)["num_gaussians"] > 0
