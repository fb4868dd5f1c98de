"""`validate` refuses scenes that training could not use."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from core_rasterizer import Camera
from registry import Fact, PointCloud, Scene, SceneError, View, validate
from registry.contract.checks.scene import check_initialization
from registry.testing import tiny_scene


def with_view(**changes: Any) -> Scene:
    """Return the tiny scene with changes of its second training view."""
    scene = tiny_scene()
    return replace(scene, train=(scene.train[0], replace(scene.train[1], **changes)))


def with_camera(**changes: Any) -> Scene:
    return with_view(camera=replace(tiny_scene().train[1].camera, **changes))


def pose_with(row: int, column: int, value: float) -> torch.Tensor:
    pose: torch.Tensor = tiny_scene().train[1].camera.world_to_camera.clone()
    pose[row, column] = value
    return pose


MAP = torch.ones(24, 32)


def some_points(position: float = 0.0, color: float = 0.5) -> Scene:
    points = PointCloud(torch.full((4, 3), position), torch.full((4, 3), color))
    return replace(tiny_scene(), points=points)


FAULTS: dict[str, tuple[Scene, str]] = {
    "no training view": (replace(tiny_scene(), train=()), "no training view"),
    "one name twice": (with_view(name="view0"), "two views are named 'view0'"),
    "empty name": (with_view(name=""), "plain file name"),
    "name with a folder": (with_view(name="a/b"), "plain file name"),
    "name that climbs": (with_view(name=".."), "plain file name"),
    "name with a backslash": (with_view(name="a\\b"), "plain file name"),
    "name with a control character": (with_view(name="a\nb"), "plain file name"),
    "endless name": (with_view(name="a" * 201), "plain file name"),
    "image size": (with_view(image=torch.zeros(24, 31, 3)), "but its camera is 32x24"),
    "image range": (with_view(image=torch.full((24, 32, 3), 1.5)), "outside [0, 1]"),
    "nan in image": (with_view(image=torch.full((24, 32, 3), float("nan"))), "outside [0, 1]"),
    "rough rotation": (
        with_camera(world_to_camera=pose_with(0, 1, 5e-4)),
        "not orthonormal (off by 0.0005)",
    ),
    "far away": (with_camera(world_to_camera=pose_with(0, 3, 1e10)), "too far away"),
    "long focal length": (with_camera(fx=1e7), "focal length fx is 1e+07 px"),
    "short focal length": (with_camera(fy=0.1), "focal length fy is 0.1 px"),
    "same pose": (
        with_camera(world_to_camera=tiny_scene().train[0].camera.world_to_camera),
        "have the same pose",
    ),
    "mask size": (with_view(mask=torch.ones(24, 31, dtype=torch.bool)), "mask has shape (24, 31)"),
    "mask type": (with_view(mask=MAP), "mask is torch.float32, not torch.bool"),
    "image type": (with_view(image=torch.ones(24, 32, 3).double()), "image is torch.float64"),
    "empty mask": (with_view(mask=MAP < 0), "leaves no pixel"),
    "depth size": (with_view(depth=torch.ones(3, 3)), "depth has shape (3, 3)"),
    "nan depth": (with_view(depth=MAP * float("nan")), "negative or not finite"),
    "negative depth": (with_view(depth=-MAP), "negative or not finite"),
    "bounds": (replace(tiny_scene(), bounds=(2.0, 1.0)), "0 < near < far"),
    "nan bounds": (replace(tiny_scene(), bounds=(float("nan"), 1.0)), "0 < near < far"),
    "nan points": (some_points(float("nan")), "points.positions[0] is not finite"),
    "colours": (some_points(color=1.5), "colours outside [0, 1]"),
    "one fact twice": (
        replace(tiny_scene(), facts=(Fact("lens", 1), Fact("lens", 2))),
        "'lens' does not have a plain, unique name",
    ),
    "name of a fact": (
        replace(tiny_scene(), facts=(Fact("a.b", 1),)),
        "'a.b' does not have a plain",
    ),
    "nan in a fact": (
        replace(tiny_scene(), facts=(Fact("scale", float("nan")),)),
        "'scale' is not finite",
    ),
}


@pytest.mark.parametrize(("scene", "message"), FAULTS.values(), ids=list(FAULTS))
def test_faults_are_refused(scene: Scene, message: str) -> None:
    with pytest.raises(SceneError) as caught:
        validate(scene)
    assert message in caught.value.what
    assert caught.value.where
    assert caught.value.fix


@pytest.mark.parametrize("name", ["10:20", "a*b", "NUL", "com1.left", "a.", "b "])
def test_names_that_windows_cannot_have_are_refused_there(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert validate(with_view(name=name))
    monkeypatch.setattr("sys.platform", "win32")
    with pytest.raises(SceneError, match="plain file name"):
        validate(with_view(name=name))
    assert validate(with_view(name="console.1"))


def test_a_valid_scene_is_returned_unchanged() -> None:
    for scene in (
        tiny_scene(),
        with_view(mask=MAP > 0, depth=MAP, name="Größe 1.2"),
        with_camera(world_to_camera=pose_with(0, 1, 5e-5), fx=3000.0),
        some_points(),
    ):
        assert validate(scene) is scene


def test_of_views_with_the_same_pose_the_first_stays(caplog: pytest.LogCaptureFixture) -> None:
    scene = tiny_scene()
    first, second = scene.train[:2]
    moved = replace(second.camera, world_to_camera=pose_with(0, 3, 3.0))
    third = replace(second, name="third", camera=moved)
    copy = replace(second, name="copy", camera=first.camera)
    checked = validate(replace(scene, train=(first, second, copy, third)))
    assert [view.name for view in checked.train] == [first.name, second.name, "third"]
    assert checked.fact("left_out_for_equal_pose") == "copy"
    assert f"{first.name} and copy have the same pose; copy is left out" in caplog.text
    assert validate(checked) is checked


def test_a_test_view_may_share_a_pose() -> None:
    scene = tiny_scene()
    test = View("again", scene.train[0].camera, scene.train[0].image)
    assert validate(replace(scene, test=(test,))).test == (test,)


def test_a_rotation_in_place_is_another_pose() -> None:
    scene = tiny_scene()
    pose = torch.eye(4, dtype=torch.float64)
    pose[0, 0] = pose[2, 2] = torch.cos(torch.tensor(0.1, dtype=torch.float64))
    pose[0, 2] = torch.sin(torch.tensor(0.1, dtype=torch.float64))
    pose[2, 0] = -pose[0, 2]
    first = scene.train[0].camera
    turned = pose @ first.world_to_camera
    camera = Camera(turned, first.fx, first.fy, first.cx, first.cy, first.width, first.height)
    validate(with_view(camera=camera))


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (PointCloud(torch.zeros(0, 3), torch.zeros(0, 3)), "no points"),
        (PointCloud(torch.full((1, 3), math.nan), torch.zeros(1, 3)), r"positions\[0\]"),
        (PointCloud(torch.zeros(2, 3), torch.zeros(1, 3)), "colors has the shape"),
        (PointCloud(torch.zeros(2, 2), torch.zeros(2, 3)), "positions has the shape"),
        (
            PointCloud(torch.zeros(2, 3), torch.zeros(2, 3), scales=torch.tensor([1.0, 0.0])),
            r"scales\[1\]",
        ),
        (
            PointCloud(torch.zeros(2, 3), torch.zeros(2, 3), opacities=torch.tensor([1.0, 0.5])),
            r"opacities\[0\]",
        ),
        (
            PointCloud(
                torch.zeros(2, 3), torch.zeros(2, 3), scales=torch.tensor([[1.0, 2, 0]] * 2)
            ),
            r"scales\[0\]",
        ),
        (
            PointCloud(torch.zeros(2, 3), torch.zeros(2, 3), scales=torch.ones(2, 2)),
            r"expected \(2,\) or \(2, 3\)",
        ),
        (
            PointCloud(torch.zeros(2, 3), torch.zeros(2, 3), quaternions=torch.zeros(2, 4)),
            r"quaternions\[0\]",
        ),
        (
            PointCloud(torch.zeros(2, 3), torch.zeros(2, 3), sh=torch.zeros(2, 5, 3)),
            "sh has the shape",
        ),
    ],
)
def test_impossible_points_are_refused(points: PointCloud, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        check_initialization(points, tiny_scene().for_training(), {})


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_harmonics_of_each_degree_are_accepted(coefficients: int) -> None:
    points = tiny_scene().points
    assert points is not None
    sh = torch.zeros(len(points), coefficients, 3)
    check_initialization(replace(points, sh=sh), tiny_scene().for_training(), {})
