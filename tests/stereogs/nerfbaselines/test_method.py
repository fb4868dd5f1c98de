"""The method through the registry and types of NerfBaselines, if installed: `make nerfbaselines`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stereogs

nerfbaselines = pytest.importorskip("nerfbaselines")


@pytest.fixture(scope="module")
def scene() -> stereogs.Scene:
    return stereogs.load_scene(
        {
            "name": "room",
            "scene": {"use": "procedural", "width": 64, "height": 48},
            "initializer": "sfm",
        }
    )


def dataset_of(views: Any, **cameras: Any) -> Any:
    """A dataset of NerfBaselines: its cameras are camera to world."""
    poses = [np.linalg.inv(view.camera.world_to_camera.numpy())[:3] for view in views]
    lenses = [[view.camera.fx, view.camera.fy, view.camera.cx, view.camera.cy] for view in views]
    return nerfbaselines.new_dataset(
        cameras=nerfbaselines.new_cameras(
            poses=np.array(poses, np.float32),
            intrinsics=np.array(lenses, np.float32),
            camera_models=np.zeros(len(views), np.int32),
            image_sizes=np.array([[64, 48]] * len(views), np.int32),
            **cameras,
        ),
        image_paths=[f"/room/{view.name}.png" for view in views],
        image_paths_root="/room",
        images=[np.uint8(255 * view.image.numpy() + 0.5) for view in views],
        metadata={"color_space": "srgb"},
    )


@pytest.fixture(scope="module")
def method_class() -> Any:
    """Load the method through its entry point, as the command line of NerfBaselines does."""
    spec = nerfbaselines.get_method_spec("stereogs")
    with nerfbaselines.build_method_class(spec, backend="python") as found:
        yield found


def test_it_trains_renders_saves_and_loads(
    scene: stereogs.Scene, method_class: Any, tmp_path: Path
) -> None:
    limits = np.array([scene.bounds] * len(scene.train), np.float32)
    overrides = {
        "pipeline": "3dgs",
        "training.iterations": 100,
        "initializer": {"use": "random", "count": 1000},
    }
    method = method_class(
        train_dataset=dataset_of(scene.train, nears_fars=limits), config_overrides=overrides
    )
    assert isinstance(method, nerfbaselines.Method)
    assert method.get_info()["num_iterations"] == 1
    method.save(str(tmp_path / "0"))
    assert method_class(checkpoint=str(tmp_path / "0")).get_info()["loaded_step"] is None
    logged = method.train_iteration(0)
    assert logged["num_gaussians"] >= 1000
    test = dataset_of(scene.test)
    answer = method.render(test["cameras"][:1])
    error = np.mean((answer["color"] - scene.test[0].image.numpy()) ** 2)
    assert -10 * np.log10(error) > 13
    assert answer["depth"].shape == answer["accumulation"].shape == (48, 64)
    method.save(str(tmp_path / "1"))
    again = method_class(checkpoint=str(tmp_path / "1"))
    assert again.get_info()["loaded_step"] == 1
    assert again.get_info()["hparams"]["pipeline"] == "3dgs"
    same = again.render(test["cameras"][:1], options={"outputs": ("color",)})
    assert list(same) == ["color"]
    np.testing.assert_allclose(same["color"], answer["color"], atol=1e-6)


def test_unknown_bounds_are_refused(scene: stereogs.Scene, method_class: Any) -> None:
    method = method_class(train_dataset=dataset_of(scene.train))
    with pytest.raises(stereogs.ExplainedError, match="the depth bounds are unknown"):
        method.train_iteration(0)
