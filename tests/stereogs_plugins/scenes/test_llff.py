from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch
from PIL import Image
from torch import Tensor
from torch.nn.functional import grid_sample

from core_rasterizer import Camera
from registry import Scene, SceneError, View
from registry.toolkit.photos import SplitSettings
from stereogs_plugins.scenes.llff import LLFFScene, stereogs_register_scenes
from tests.data import data_folder
from tests.stereogs_plugins.building import build, offered

POSE = [[0, 1, 0, 0, 24], [1, 0, 0, 0, 32], [0, 0, -1, 0, 40]]
"""Looks along world +z: columns down, right, backwards, centre, (height, width, focal)."""
BOUNDS = [1.0, 9.0]


def write_scene(folder: Path, count: int = 9) -> Path:
    """A scene of `count` images of 16x12, half the size in the camera file."""
    (folder / "images_2").mkdir(parents=True)
    for index in range(count):
        pixels = np.full((12, 16, 3), 10 * index, dtype=np.uint8)
        Image.fromarray(pixels).save(folder / "images_2" / f"photo_{index:02d}.png")
    rows = np.array([np.ravel(POSE).tolist() + BOUNDS] * count)
    rows[:, 3] = np.arange(count)  # x of the camera centre
    np.save(folder / "poses_bounds.npy", rows)
    return folder


def write_points(folder: Path, image_count: int = 9) -> None:
    """Four points, seen by images (1-based) 2 3 | 3 | 2 5 | 1 9."""
    np.savez(
        folder / "points3d.npz",
        xyz=np.arange(12, dtype=np.float32).reshape(4, 3),
        rgb=np.array([[255, 0, 51]] * 4, dtype=np.uint8),
        track_len=np.array([2, 1, 2, 2]),
        track_image_ids=np.array([2, 3, 3, 2, 5, 1, image_count]),
    )


def load(folder: Path, **settings: object) -> Scene:
    return build(LLFFScene, path=folder, **settings).load()


def test_registers_as_llff() -> None:
    assert offered(stereogs_register_scenes) == {"llff": LLFFScene}


@pytest.mark.parametrize(
    ("count", "views", "train", "test"),
    [
        (20, 3, [1, 10, 19], [0, 8, 16]),
        (34, 3, [1, 17, 33], [0, 8, 16, 24, 32]),
        (7, 3, [1, 3, 6], [0]),  # 2.5 rounds to the even 2
        (7, None, [1, 2, 3, 4, 5, 6], [0]),
        (7, 0, [1, 2, 3, 4, 5, 6], [0]),
        (7, 1, [1], [0]),
    ],
)
def test_split_is_the_published_one(
    count: int, views: int | None, train: list[int], test: list[int]
) -> None:
    settings = SplitSettings(train_views=views, test_every=8)
    assert settings.split(count, "")[:2] == (train, test)


@pytest.mark.parametrize(("count", "test"), [(7, []), (8, [0]), (17, [0, 8, 16])])
def test_from_eight_photographs_on_every_eighth_tests(count: int, test: list[int]) -> None:
    assert SplitSettings.model_validate({}).split(count, "")[1] == test


def test_unused_photographs_are_counted(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    SplitSettings(train_views=3, test_every=8).split(20, "")
    assert "20 photographs: 3 train, 3 are held out, 14 are not used" in caplog.text


def test_a_split_without_training_views() -> None:
    with pytest.raises(SceneError) as caught:
        SplitSettings(train_views=None, test_every=1).split(9, "")
    assert caught.value.fix == "raise `test_every`"


def test_camera_conventions(tmp_path: Path) -> None:
    scene = load(write_scene(tmp_path / "room"), downsample=2)
    assert scene.name == "room"
    camera = scene.train[0].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (20, 20, 8, 6)
    assert (camera.width, camera.height) == (16, 12)
    assert [float(view.camera.center[0]) for view in scene.test] == [0, 8]
    # A point to the right, below and in front has positive camera coordinates.
    pose = scene.test[0].camera.world_to_camera
    torch.testing.assert_close(
        pose @ torch.tensor([1.0, 2.0, 3.0, 1.0]).double(),
        torch.tensor([1.0, 2.0, 3.0, 1.0]).double(),
    )
    assert [float(view.image[0, 0, 0]) for view in scene.test] == pytest.approx([0, 80 / 255])


def test_bounds_come_from_the_training_views_alone(tmp_path: Path) -> None:
    folder = write_scene(tmp_path)
    rows = np.load(folder / "poses_bounds.npy")
    rows[0, 15:] = 0.1, 100  # a test view
    rows[1, 15:] = 0.5, 8
    np.save(folder / "poses_bounds.npy", rows)
    assert load(folder, downsample=2).bounds == (0.5, 9)


def test_only_points_that_two_training_views_see(tmp_path: Path) -> None:
    folder = write_scene(tmp_path)
    write_points(folder)
    points = load(folder, downsample=2, train_views=None).points
    assert points is not None
    assert points.positions[:, 0].tolist() == [0, 6]
    torch.testing.assert_close(points.colors[0], torch.tensor([1.0, 0.0, 0.2]))
    points = load(folder, downsample=2, train_views=3).points  # views 1, 4 and 7
    assert points is not None
    assert points.positions[:, 0].tolist() == [6]
    assert load(folder, downsample=2, train_views=2).points is None  # views 1 and 7
    assert load(folder, downsample=2, train_views=None, points=False).points is None


def write_colmap_model(folder: Path) -> None:
    """Three points, seen by images 0 1 | 1 2 | 2 of the sorted list."""
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_id(
        1, pycolmap.CameraModelId.SIMPLE_PINHOLE, 40, 32, 24
    )
    model.add_camera_with_trivial_rig(camera)
    for index in range(9):
        image = pycolmap.Image(
            name=f"IMG_{9 - index}.JPG", camera_id=1, image_id=index + 1, keypoints=np.zeros((4, 2))
        )
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    # Image ids run against the names, so id 9 is the first of the sorted images.
    for number, images in enumerate([[9, 8], [8, 7], [7]]):
        track = pycolmap.Track()
        for image_id in images:
            track.add_element(image_id, number)
        model.add_point3D(np.full(3, float(number)), track, np.array([0, 255, 0], dtype=np.uint8))
    (folder / "sparse" / "0").mkdir(parents=True)
    model.write(folder / "sparse" / "0")


def test_points_of_a_colmap_model(tmp_path: Path) -> None:
    folder = write_scene(tmp_path)
    write_colmap_model(folder)
    points = load(folder, downsample=2, train_views=None).points
    assert points is not None
    assert points.positions.tolist() == [[1, 1, 1]]
    assert points.colors.tolist() == [[0, 1, 0]]


@pytest.mark.parametrize("name", ["images.bin", "points3D.bin"])
def test_a_damaged_colmap_model_is_an_error(name: str, tmp_path: Path) -> None:
    folder = write_scene(tmp_path)
    write_colmap_model(folder)
    path = folder / "sparse" / "0" / name
    whole = path.read_bytes()
    for damaged in (b"", whole[:5], whole[: len(whole) // 2], whole[:-3], whole + b"xyz"):
        path.write_bytes(damaged)
        with pytest.raises(SceneError, match="COLMAP model cannot be read") as caught:
            load(folder, downsample=2)
        assert "points: false" in caught.value.fix


def delete_folder(folder: Path) -> None:
    folder.rename(folder.with_name("elsewhere"))


def delete_poses(folder: Path) -> None:
    (folder / "poses_bounds.npy").unlink()


def delete_an_image(folder: Path) -> None:
    (folder / "images_2" / "photo_04.png").unlink()


def other_image_size(folder: Path) -> None:
    Image.new("RGB", (32, 24)).save(folder / "images_2" / "photo_08.png")


def cropped_images(folder: Path) -> None:
    for path in (folder / "images_2").iterdir():
        Image.new("RGB", (12, 12)).save(path)


def broken_image(folder: Path) -> None:
    path = folder / "images_2" / "photo_01.png"
    path.write_bytes(path.read_bytes()[:45])


def change_row(folder: Path, column: int, value: float) -> None:
    rows = np.load(folder / "poses_bounds.npy")
    rows[1, column] = value
    np.save(folder / "poses_bounds.npy", rows)


def nan_pose(folder: Path) -> None:
    change_row(folder, 6, np.nan)


def skewed_pose(folder: Path) -> None:
    change_row(folder, 0, 0.5)


def bounds_out_of_order(folder: Path) -> None:
    change_row(folder, 15, 99)


def pickled_poses(folder: Path) -> None:
    np.save(folder / "poses_bounds.npy", np.array([{"a": 1}]), allow_pickle=True)


def truncated_poses(folder: Path) -> None:
    path = folder / "poses_bounds.npy"
    path.write_bytes(path.read_bytes()[:200])


def wrong_shape(folder: Path) -> None:
    np.save(folder / "poses_bounds.npy", np.zeros((9, 15)))


def unreadable_points(folder: Path) -> None:
    (folder / "points3d.npz").write_bytes(b"PK not an archive")


def points_of_other_images(folder: Path) -> None:
    write_points(folder, image_count=10)


@pytest.mark.parametrize(
    ("damage", "what", "where"),
    [
        (delete_folder, "does not exist", "room"),
        (delete_poses, "missing", "poses_bounds.npy"),
        (delete_an_image, "9 poses but 8 images", "images_2"),
        (other_image_size, "32x24, the others are 16x12", "photo_08"),
        (cropped_images, "another shape", "poses_bounds.npy, row "),
        (broken_image, "cannot be read", "photo_01.png"),
        (nan_pose, "nan in column 6", "poses_bounds.npy, row 1"),
        (lambda folder: change_row(folder, 4, -12), "the height is -12", "poses_bounds.npy, row 1"),
        (lambda folder: change_row(folder, 9, -16), "the width is -16", "poses_bounds.npy, row 1"),
        (
            lambda folder: change_row(folder, 14, -40),
            "focal length is -40",
            "poses_bounds.npy, row 1",
        ),
        (skewed_pose, "not a rotation", "poses_bounds.npy, row 1"),
        (bounds_out_of_order, "depth bounds are 99", "poses_bounds.npy, row 1"),
        (pickled_poses, "cannot be read", "poses_bounds.npy"),
        (truncated_poses, "cannot be read", "poses_bounds.npy"),
        (wrong_shape, "(9, 15)", "poses_bounds.npy"),
        (unreadable_points, "points file cannot be read", "points3d.npz"),
        (points_of_other_images, "not one of the 9", "points3d.npz"),
    ],
)
def test_bad_input_is_an_error(
    damage: Callable[[Path], None], what: str, where: str, tmp_path: Path
) -> None:
    folder = write_scene(tmp_path / "room")
    damage(folder)
    with pytest.raises(SceneError) as caught:
        load(folder, downsample=2)
    assert what in caught.value.what
    assert where in caught.value.where
    assert caught.value.fix


def test_too_many_training_views(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"8 training views are wanted.* only 7") as caught:
        load(write_scene(tmp_path), downsample=2, train_views=8)
    assert "at most 7" in caught.value.fix


def test_a_missing_size_lists_the_existing_ones(tmp_path: Path) -> None:
    with pytest.raises(SceneError) as caught:
        load(write_scene(tmp_path), downsample=4)
    assert "images_2" in caught.value.fix


def colors_at(view: View, camera: Camera, points: Tensor) -> Tensor:
    """`[P, 3]`: the view's image where `camera` projects the points."""
    local = points.double() @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    x = (local[:, 0] / local[:, 2] * camera.fx + camera.cx) / camera.width * 2 - 1
    y = (local[:, 1] / local[:, 2] * camera.fy + camera.cy) / camera.height * 2 - 1
    grid = torch.stack([x, y], dim=1).float()[None, None]
    return grid_sample(view.image.permute(2, 0, 1)[None], grid, align_corners=False)[0, :, 0].T


@pytest.mark.parametrize(("name", "count"), [("llff_fern", 1407), ("llff_flower", 2388)])
def test_real_points_have_the_colors_of_the_photographs(name: str, count: int) -> None:
    scene = load(data_folder(name))
    assert scene.points is not None
    assert len(scene.points) == count
    right: list[float] = []
    wrong: list[float] = []
    for view, other in zip(scene.train, scene.train[1:] + scene.train[:1], strict=True):
        for camera, errors in ((view.camera, right), (other.camera, wrong)):
            difference = colors_at(view, camera, scene.points.positions) - scene.points.colors
            errors.append(float(difference.abs().mean(dim=1).median()))
    assert max(right) < 0.08
    assert min(wrong) > 2 * max(right)


def test_fern_is_the_published_scene() -> None:
    scene = load(data_folder("llff_fern"))
    assert [view.name for view in scene.train] == ["image001", "image010", "image019"]
    assert [view.name for view in scene.test] == ["image000", "image008", "image016"]
    camera = scene.train[0].camera
    assert camera.fx == pytest.approx(407.566, abs=1e-3)
    assert (camera.cx, camera.cy, camera.width, camera.height) == (252, 189, 504, 378)


def test_rows_of_removed_photographs(tmp_path: Path) -> None:
    folder = write_scene(tmp_path)
    names = [f"photo_{index:02d}.png" for index in range(9)]
    (folder / "split.json").write_text(json.dumps({"all_names": names}))
    for index in (2, 3):  # neither trains nor tests
        (folder / "images_2" / names[index]).unlink()
    scene = load(folder, downsample=2)
    assert [view.name for view in scene.train] == ["photo_01", "photo_04", "photo_07"]
    assert [float(view.camera.center[0]) for view in scene.train] == [1, 4, 7]
    (folder / "images_2" / names[4]).unlink()
    with pytest.raises(SceneError, match="photograph is missing"):
        load(folder, downsample=2)
    (folder / "split.json").write_text(json.dumps({"all_names": names[1:]}))
    with pytest.raises(SceneError, match="9 poses but 8 images"):
        load(folder, downsample=2)


def test_another_image_folder_and_full_size_photographs(tmp_path: Path) -> None:
    folder = write_scene(tmp_path)
    (folder / "images_2").rename(folder / "images_small")
    assert load(folder, images="images_small").train[0].camera.width == 16
    (folder / "images_small").rename(folder / "images")
    scene = load(folder, downsample=4, image_source="resize")
    assert (scene.train[0].camera.width, scene.train[0].camera.fx) == (4, 5)
    assert scene.fact("changed") == "resized from 16x12 to 4x3 with the bicubic filter"


def test_bonsai_has_the_split_of_the_whole_capture() -> None:
    folder = data_folder("mip360_bonsai")
    expected = json.loads((folder / "split.json").read_text())
    for count in (12, 24):
        scene = load(folder, images="images_800", bounds="estimate", train_views=count)
        assert [f"{view.name}.JPG" for view in scene.train] == expected[f"train_{count}"]
        assert [f"{view.name}.JPG" for view in scene.test] == expected["test_every_8"]
        camera = scene.train[0].camera
        assert (camera.width, camera.height) == (800, 533)
        assert (camera.fx, camera.fy) == pytest.approx((826.87, 826.60), abs=0.05)
        assert scene.bounds[0] > 0.2  # the file says 0.1 and 500 of every scene
        assert scene.bounds[1] < 100


def test_copies_with_another_suffix_are_named(tmp_path: Path) -> None:
    folder = write_scene(tmp_path)
    Image.new("RGB", (16, 12)).save(folder / "images_2" / "photo_03.bmp")
    with pytest.raises(SceneError, match="9 poses but 10 images") as caught:
        load(folder, downsample=2)
    assert "photo_03.bmp" in caught.value.fix
