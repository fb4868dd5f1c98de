from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from core_rasterizer import PlyError
from registry import Scene, SceneError
from stereogs_plugins.scenes.nerfstudio import NerfstudioScene, stereogs_register_scenes
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.scenes.small_scenes import (
    COLORS,
    POINTS,
    World,
    assert_sees_the_points,
    write_nerfstudio,
)


def load(folder: Path, **settings: object) -> Scene:
    return build(NerfstudioScene, path=folder, **settings).load()


def edit(folder: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    path = folder / "transforms.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    return folder


def test_registers_as_nerfstudio() -> None:
    assert offered(stereogs_register_scenes) == {"nerfstudio": NerfstudioScene}


def test_frames_are_split_by_sorted_names(tmp_path: Path) -> None:
    folder = write_nerfstudio(tmp_path, World())
    scene = load(folder, train_views=3)
    assert [view.name for view in scene.train] == ["frame_00001", "frame_00004", "frame_00007"]
    assert [view.name for view in scene.test] == ["frame_00000", "frame_00008"]
    assert len(load(folder).train) == 7


def test_the_split_of_the_file_takes_precedence(tmp_path: Path) -> None:
    names = [f"images/frame_{index:05d}.png" for index in range(9)]

    def change(content: dict[str, Any]) -> None:
        content["train_filenames"], content["test_filenames"] = names[:5], names[7:]

    folder = edit(write_nerfstudio(tmp_path, World()), change)
    scene = load(folder, train_views=3)
    assert [view.name[-1] for view in scene.train] == ["0", "2", "4"]
    assert [view.name[-1] for view in scene.test] == ["7", "8"]
    assert len(load(folder).train) == 5
    assert len(load(folder, test_every=0).train) == 9
    with pytest.raises(SceneError, match="`train_views` is 6, but the file lists 5"):
        load(folder, train_views=6)
    edit(folder, lambda content: content["test_filenames"].append(names[0]))
    with pytest.raises(SceneError, match=r"lists 'images/frame_00000.png' twice"):
        load(folder)
    edit(folder, lambda content: content["test_filenames"].append("images/other.png"))
    with pytest.raises(SceneError, match=r"'images/other.png', which is not a frame"):
        load(folder)


def test_photographs_are_undistorted(tmp_path: Path) -> None:
    bent = (0.7, 0.2, 0.01, -0.02)
    world = World(width=256, height=192, shift=(5.0, -7.0), distortion=bent)
    scene = load(write_nerfstudio(tmp_path, world))
    assert_sees_the_points(scene, tolerance=60)
    assert "undistorted" in str(scene.fact("changed"))


def test_fisheye_photographs_are_undistorted(tmp_path: Path) -> None:
    """Equidistant: a ray at angle a from the axis meets the picture at focal * a."""
    world = World(width=256, height=192)
    folder = edit(
        write_nerfstudio(tmp_path, world), lambda c: c.update(camera_model="OPENCV_FISHEYE")
    )
    for index in range(world.count):
        local = POINTS @ world.pose(index)[:3, :3].T + world.pose(index)[:3, 3]
        radius = np.hypot(local[:, 0], local[:, 1])
        stretch = np.arctan2(radius, local[:, 2]) / np.maximum(radius, 1e-12)
        pixels = np.full((192, 256, 3), 60, dtype=np.uint8)
        for k in np.argsort(-local[:, 2]):
            column, row = (world.focal * local[k, :2] * stretch[k] + [128, 96]).astype(int)
            pixels[row - 1 : row + 2, column - 1 : column + 2] = COLORS[k]
        Image.fromarray(pixels).save(folder / "images" / f"frame_{index:05d}.png")
    assert_sees_the_points(load(folder), tolerance=60)


def test_a_frame_can_have_its_own_lens_and_a_mask(tmp_path: Path) -> None:
    folder = write_nerfstudio(tmp_path, World())
    mask = np.zeros((48, 64), dtype=np.uint8)
    mask[10:] = 255
    Image.fromarray(mask).save(folder / "mask.png")

    def change(content: dict[str, Any]) -> None:
        frame = next(f for f in content["frames"] if f["file_path"].endswith("1.png"))
        frame.update(fl_x=70.0, mask_path="mask.png")
        content.update(applied_transform=[[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]])

    first, second = load(edit(folder, change)).train[:2]
    assert (first.camera.fx, first.camera.fy) == pytest.approx((70, World().focal))
    assert second.camera.fx == pytest.approx(World().focal)
    assert first.mask is not None
    assert first.mask.sum() == 38 * 64
    assert second.mask is None


def write_ply(folder: Path) -> None:
    header = "ply\nformat ascii 1.0\nelement vertex 1\n"
    columns = [f"property float {name}\n" for name in "xyz"]
    columns += [f"property uchar {name}\n" for name in ("red", "green", "blue")]
    text = header + "".join(columns) + "end_header\n0.5 -0.25 2 255 0 51\n"
    (folder / "points.ply").write_text(text)


def test_points_are_optional(tmp_path: Path) -> None:
    folder = edit(
        write_nerfstudio(tmp_path, World()), lambda c: c.update(ply_file_path="points.ply")
    )
    write_ply(folder)
    assert load(folder).points is None
    scene = load(folder, points=True)
    assert scene.points is not None
    assert scene.points.positions.tolist() == [[0.5, -0.25, 2.0]]
    torch.testing.assert_close(scene.points.colors, torch.tensor([[1.0, 0.0, 0.2]]))
    assert scene.fact("points_seen_by") == "all photographs"
    (folder / "points.ply").write_text("ply\n")
    with pytest.raises(PlyError):
        load(folder, points=True)


def first_frame(**fields: Any) -> Callable[[dict[str, Any]], object]:
    return lambda content: content["frames"][0].update(fields)


DAMAGES: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "no frames": (lambda c: c.update(frames=[]), "no frame"),
    "no focal length": (lambda c: (c.pop("fl_x"), c["frames"][0].pop("fl_x")), "'fl_x' is missing"),
    "text for a number": (lambda c: c.update(w="64"), "'w' cannot be used"),
    "nan": (lambda c: c.update(cx=float("nan")), "'cx' cannot be used"),
    "negative": (first_frame(fl_y=-3.0), "focal length fy is -3"),
    "k4": (first_frame(k4=0.1), "k4 is not 0"),
    "unknown model": (lambda c: c.update(camera_model="EQUIRECTANGULAR"), "'camera_model'"),
    "climbing name": (first_frame(file_path="images/../../a.png"), "does not stay inside"),
    "climbing mask": (first_frame(mask_path="../a.png"), "does not stay inside"),
    "short matrix": (first_frame(transform_matrix=[[1, 0, 0, 0]]), "transform_matrix"),
    "mirrored": (
        first_frame(transform_matrix=np.diag([-1.0, 1, 1, 1]).tolist()),
        "not a rotation",
    ),
    "one frame twice": (lambda c: c["frames"].append(c["frames"][0]), "two views are named"),
}


@pytest.mark.parametrize(("damage", "message"), DAMAGES.values(), ids=list(DAMAGES))
def test_bad_input_is_an_error(
    damage: Callable[[dict[str, Any]], object], message: str, tmp_path: Path
) -> None:
    folder = edit(write_nerfstudio(tmp_path, World()), damage)
    with pytest.raises(SceneError) as caught:
        load(folder, train_views=None)
    assert message in caught.value.what
    assert caught.value.where


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"transforms.json is missing"):
        load(tmp_path)
