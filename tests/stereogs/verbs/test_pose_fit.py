"""`stereogs check` finds poses that do not fit their photographs, and names what mends them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

import stereogs
from registry import View
from stereogs.verbs.check.pose_fit import MatchedPair, fault, matched_pairs, pose_fault
from tests.host import main

Pose = NDArray[np.float64]
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


@cache
def views() -> tuple[View, ...]:
    """Three views of the procedural room, near enough for features to match."""
    scene = {"use": "procedural", "width": 400, "height": 300, "test_views": 0}
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("STEREOGS_PLUGINS", raising=False)
        return stereogs.load_scene({"name": "room", "scene": scene, "initializer": "sfm"}).train


@cache
def pairs() -> tuple[MatchedPair, ...]:
    return tuple(matched_pairs(views()))


def poses() -> list[Pose]:
    return [view.camera.world_to_camera.double().numpy() for view in views()]


def built(rotation: Pose, translation: Pose) -> Pose:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


def with_w_last(pose: Pose) -> Pose:
    read = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return built(Rotation.from_quat(read, scalar_first=True).as_matrix(), pose[:3, 3])


def test_right_poses_fit() -> None:
    assert sum(len(pair.rays) for pair in pairs()) > 100
    assert pose_fault(views()) is None


@pytest.mark.parametrize(
    ("wrong", "remedy"),
    [
        (lambda pose: FLIP @ pose, "OpenCV's and OpenGL's axes are confused"),
        (lambda pose: np.linalg.inv(pose), "exchanged.*then multiply"),
        (lambda pose: FLIP @ np.linalg.inv(FLIP @ pose), r"write the inverse of each pose\)"),
        (with_w_last, "write w first"),
        (lambda pose: built(pose[:3, :3], -pose[:3, :3].T @ pose[:3, 3]), "write -R C"),
        (lambda pose: built(pose[:3, :3].T, pose[:3, 3]), "each world-to-camera matrix"),
        (
            lambda pose: np.linalg.inv(built(pose[:3, :3], np.linalg.inv(pose)[:3, 3])),
            "each camera-to-world matrix",
        ),
    ],
)
def test_a_wrong_reading_is_named(wrong: Callable[[Pose], Pose], remedy: str) -> None:
    text = fault(pairs(), [wrong(pose) for pose in poses()])
    assert text is not None
    assert re.search(remedy, text)


def test_poses_of_other_photographs_are_found_without_a_cause() -> None:
    text = fault(pairs(), [*poses()[1:], poses()[0]])
    assert text is not None
    assert "names, order" in text


def test_a_few_matches_are_no_evidence() -> None:
    few = [pair._replace(rays=pair.rays[:15], other_rays=pair.other_rays[:15]) for pair in pairs()]
    assert fault(few[:3], [FLIP @ pose for pose in poses()]) is None


@pytest.mark.parametrize("inverted", [True, False])
def test_the_command_names_the_remedy_and_the_remedy_works(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    inverted: bool,
) -> None:
    monkeypatch.delenv("STEREOGS_PLUGINS", raising=False)
    frames = []
    for number, view in enumerate(views()):
        Image.fromarray((255 * view.image).round().byte().numpy()).save(tmp_path / f"{number}.png")
        written = np.linalg.inv(FLIP @ view.camera.world_to_camera.double().numpy())
        if inverted:
            written = np.linalg.inv(written)
        frames.append({"file_path": f"{number}.png", "transform_matrix": written.tolist()})
    lens = views()[0].camera
    content = {"fl_x": lens.fx, "fl_y": lens.fy, "cx": lens.cx, "cy": lens.cy}
    content |= {"w": lens.width, "h": lens.height}
    (tmp_path / "transforms.json").write_text(json.dumps({**content, "frames": frames}))
    assert main(["check", str(tmp_path), "--out", str(tmp_path / "check.png")]) == 0
    assert ("write the inverse of each pose)" in capsys.readouterr().out) == inverted
