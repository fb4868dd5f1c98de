from __future__ import annotations

import json
import logging
import math
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
    with pytest.raises(SceneError, match="6 training views are wanted, but only 5"):
        load(folder, train_views=6)
    edit(folder, lambda content: content["test_filenames"].append(names[0]))
    with pytest.raises(SceneError, match=r"images/frame_00000.png' is a training and a test view"):
        load(folder)
    edit(folder, lambda content: content["test_filenames"].append(names[0]))
    with pytest.raises(SceneError, match=r"lists 'images/frame_00000.png' twice"):
        load(folder)
    edit(folder, lambda content: content["test_filenames"].append("images/other.png"))
    edit(folder, lambda content: [content["test_filenames"].remove(names[0]) for _ in range(2)])
    with pytest.raises(SceneError, match=r"'images/other.png', which is not a frame"):
        load(folder)


@pytest.mark.parametrize(
    ("lists", "train", "test"),
    [
        ({"train": (0, 1, 2), "val": (3, 4)}, "012", "34"),
        ({"train": (0, 1, 2)}, "012", "345678"),
        ({"val": (3, 4)}, "0125678", "34"),
        ({"train": (0, 1), "val": (2,), "test": (3,)}, "01", "3"),
    ],
    ids=["train and val", "train", "val", "all"],
)
def test_lists_of_the_file_split_its_frames(
    lists: dict[str, tuple[int, ...]], train: str, test: str, tmp_path: Path
) -> None:
    def change(content: dict[str, Any]) -> None:
        for kind, numbers in lists.items():
            content[f"{kind}_filenames"] = [f"./images/frame_0000{k}.png" for k in numbers]

    scene = load(edit(write_nerfstudio(tmp_path, World()), change))
    assert "".join(view.name[-1] for view in scene.train) == train
    assert "".join(view.name[-1] for view in scene.test) == test


def test_a_frame_in_two_lists_is_refused(tmp_path: Path) -> None:
    names = [f"images/frame_0000{index}.png" for index in range(9)]
    lists = {"train_filenames": names[:5], "test_filenames": names[4:]}
    folder = edit(write_nerfstudio(tmp_path, World()), lambda content: content.update(lists))
    with pytest.raises(SceneError, match=r"frame_00004.png' is a training and a test view"):
        load(folder)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_names_as_other_systems_write_them(encoding: str, tmp_path: Path) -> None:
    folder = write_nerfstudio(tmp_path, World())

    def change(content: dict[str, Any]) -> None:
        frames = content["frames"]
        frames[0]["file_path"] = str(folder / frames[0]["file_path"])
        frames[1]["file_path"] = "./" + frames[1]["file_path"]
        frames[2]["file_path"] = frames[2]["file_path"].replace("/", "\\")
        frames[4]["file_path"] = frames[4]["file_path"].upper()
        frames[3]["transform_matrix"] = frames[3]["transform_matrix"][:3]

    path = folder / "transforms.json"
    edit(folder, change)
    path.write_bytes(path.read_text().replace("\n", "\r\n").encode(encoding))
    scene = load(folder)
    assert len(scene.train) == 7
    assert_sees_the_points(scene)


def test_a_missing_photograph_is_named_and_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = write_nerfstudio(tmp_path, World())
    (folder / "images" / "frame_00003.png").unlink()
    assert len(load(folder, test_every=0).train) == 8
    assert "frame_00003.png" in caplog.text
    for index in range(4, 9):
        (folder / "images" / f"frame_0000{index}.png").unlink()
    with pytest.raises(SceneError, match="6 of 9 photographs are missing"):
        load(folder)


def test_the_focal_length_may_be_an_angle(tmp_path: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        for fields in (content, *content["frames"]):
            for name in ("fl_x", "fl_y", "w", "h", "cx", "cy"):
                fields.pop(name, None)
        content["camera_angle_x"] = 2 * math.atan(0.5 / 1.4)

    scene = load(edit(write_nerfstudio(tmp_path, World()), change))
    assert scene.train[0].camera.fx == pytest.approx(World().focal)
    assert_sees_the_points(scene)


@pytest.mark.parametrize(
    ("fields", "same_as"),
    [
        ({"camera_model": "PINHOLE", "k1": 0.3}, {"camera_model": "OPENCV", "k1": 0.3}),
        ({"camera_model": "SIMPLE_RADIAL", "k1": 0.3}, {"camera_model": "OPENCV", "k1": 0.3}),
        ({"camera_model": None, "is_fisheye": True}, {"camera_model": "OPENCV_FISHEYE"}),
        ({"distortion_params": [0.3, 0.1, 0, 0, 0.02, 0]}, {"k1": 0.3, "k2": 0.1, "p1": 0.02}),
    ],
    ids=["pinhole", "radial", "fisheye", "list"],
)
def test_lens_fields_of_other_programs(
    fields: dict[str, object], same_as: dict[str, object], tmp_path: Path
) -> None:
    found = []
    for number, content in enumerate((fields, same_as)):
        folder = write_nerfstudio(tmp_path / str(number), World())

        def change(transforms: dict[str, Any], content: dict[str, object] = content) -> None:
            transforms.update(content)

        found.append(load(edit(folder, change)).train[0])
    assert found[0].camera.width == found[1].camera.width != 64
    torch.testing.assert_close(found[0].image, found[1].image, rtol=0, atol=0)


MASKS: dict[str, Callable[[Any], Image.Image]] = {
    "0 and 255": lambda kept: Image.fromarray(np.uint8(kept * 255)),
    "0 and 1": lambda kept: Image.fromarray(np.uint8(kept)),
    "labels": lambda kept: Image.fromarray(np.uint8(kept * 7)),
    "16 bits": lambda kept: Image.fromarray(np.uint16(kept * 65535)),
    "alpha": lambda kept: Image.fromarray(
        np.uint8(np.stack([kept * 0 + 9] * 3 + [kept * 255], axis=2))
    ),
    "colours": lambda kept: Image.fromarray(
        np.uint8(np.stack([kept * 0, kept * 200, kept * 0], axis=2))
    ),
    "palette": lambda kept: Image.fromarray(np.uint8(kept * 255)).convert("P"),
}


@pytest.mark.parametrize("kind", [*MASKS, "jpeg"])
def test_masks_of_every_kind_count_the_same_pixels(
    kind: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    folder = write_nerfstudio(tmp_path, World())
    kept = np.zeros((48, 64))
    kept[16:40, 8:48] = 1
    name = "mask.jpg" if kind == "jpeg" else "mask.png"
    MASKS.get(kind, MASKS["0 and 255"])(kept).save(folder / name)
    edit(folder, lambda c: [frame.update(mask_path=name) for frame in c["frames"]])
    view = load(folder).train[0]
    for mask in (view.mask, view.weights):
        assert mask is not None
        np.testing.assert_array_equal(mask.numpy(), kept == 1)
    assert "9 of 9 photographs have a mask" in caplog.text
    assert ("9 masks: " in caplog.text) == (kind not in ("0 and 255", "palette"))
    assert load(folder, masks=False).train[0].weights is None


def test_a_mask_of_another_shape_is_refused(tmp_path: Path) -> None:
    folder = write_nerfstudio(tmp_path, World())
    Image.fromarray(np.full((64, 48), 255, np.uint8)).save(folder / "mask.png")
    edit(folder, lambda c: [frame.update(mask_path="mask.png") for frame in c["frames"]])
    with pytest.raises(SceneError, match="the mask is 48x64, its photograph 64x48"):
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
    "no focal length": (
        lambda c: [fields.pop(name) for fields in (c, c["frames"][0]) for name in ("fl_x", "fl_y")],
        "the focal length is missing",
    ),
    "text for a number": (lambda c: c.update(w="64"), "'w' cannot be used"),
    "nan": (lambda c: c.update(cx=float("nan")), "'cx' cannot be used"),
    "negative": (first_frame(fl_y=-3.0), "focal length fy is -3"),
    "k4": (first_frame(k4=0.1), "k4 is not 0"),
    "panorama": (lambda c: c.update(camera_model="EQUIRECTANGULAR"), "model 'EQUIRECTANGULAR'"),
    "unknown model": (first_frame(camera_model="FISHEYE624"), "'FISHEYE624' is not one of"),
    "last row": (first_frame(transform_matrix=np.diag([1, 1, 1, 1.1]).tolist()), "the last row"),
    "climbing name": (first_frame(file_path="images/../../a.png"), "does not stay inside"),
    "climbing mask": (first_frame(mask_path="../a.png"), "does not stay inside"),
    "short matrix": (first_frame(transform_matrix=[[1, 0, 0, 0]]), "transform_matrix"),
    "mirrored": (
        first_frame(transform_matrix=np.diag([-1.0, 1, 1, 1]).tolist()),
        "not a rotation (mirrored)",
    ),
    "scaled": (
        first_frame(transform_matrix=np.diag([1.3, 1.3, 1.3, 1]).tolist()),
        "not a rotation (residual 0.69)",
    ),
    "centre at a corner": (lambda c: c.update(cx=0, cy=0.0), "the principal point (cx, cy) is"),
    "centre in shares": (lambda c: c.update(cx=0.5, cy=0.5), "the principal point (cx, cy) is"),
    "one frame twice": (lambda c: c["frames"].append(c["frames"][0]), "2 frames have the photo"),
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


def test_fields_and_names_as_other_programs_write_them(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Another form of an unused field, small letters, a rounded last row, escaped names."""

    def change(content: dict[str, Any]) -> None:
        content.update(applied_transform=np.eye(4).tolist(), ply_file_path="points.ply")
        content["camera_model"] = "opencv"
        for number, frame in enumerate(content["frames"]):
            frame["transform_matrix"][3][3] = 1 + 5e-7
            name = f"images/the view {number}.png"
            (tmp_path / frame["file_path"]).rename(tmp_path / name)
            frame["file_path"] = name.replace(" ", "%20")

    with caplog.at_level(logging.INFO, logger="stereogs.photos"):
        assert_sees_the_points(load(edit(write_nerfstudio(tmp_path, World()), change)))
    assert "the points of points.ply are not used; `points: true` uses them" in caplog.text


def test_photographs_of_all_names_missing_are_refused(tmp_path: Path) -> None:
    folder = write_nerfstudio(tmp_path, World())
    (folder / "images").rename(folder / "elsewhere")
    with pytest.raises(SceneError, match="9 of 9 photographs are missing") as caught:
        load(folder)
    assert "correct their names" in caught.value.fix


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"transforms.json is missing"):
        load(tmp_path)


@pytest.mark.parametrize("start", ["/mnt/me/scan/", "C:\\scans\\my scan\\", "D:/"])
def test_absolute_paths_of_another_machine_are_found_in_the_folder(
    start: str, tmp_path: Path
) -> None:
    folder = write_nerfstudio(tmp_path, World())
    expected = load(folder)
    edit(folder, lambda c: [f.update(file_path=start + f["file_path"]) for f in c["frames"]])
    assert [view.name for view in load(folder).train] == [view.name for view in expected.train]
    edit(folder, lambda c: c["frames"][0].update(file_path="/mnt/other/frame.png"))
    with pytest.raises(SceneError, match="does not stay inside"):
        load(folder)


def test_one_focal_length_is_that_of_both_sides(tmp_path: Path) -> None:
    folder = write_nerfstudio(tmp_path, World())
    edit(folder, lambda c: [fields.pop("fl_x") for fields in (c, c["frames"][0])])
    assert_sees_the_points(load(folder))
