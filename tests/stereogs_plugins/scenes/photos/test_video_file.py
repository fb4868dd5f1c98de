"""Frames of a video as a scene of photographs without cameras."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from registry import SceneError
from registry.testing import check
from stereogs_plugins.scenes.photos import VideoScene, video_file
from stereogs_plugins.scenes.photos.video_file import Candidate, chosen_frames
from tests.data import data_folder
from tests.host import main
from tests.stereogs_plugins.building import build

PHOTOGRAPHS, COPIES = 5, 3


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Real photographs of a moving camera, each in three frames, the middle one of them blurred."""
    paths = sorted((data_folder("llff_fern") / "images_8").iterdir())[: 4 * PHOTOGRAPHS : 4]
    pictures = [np.asarray(cv2.imread(str(path))) for path in paths]
    path = tmp_path_factory.mktemp("videos") / "fern clip.mp4"
    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10, (width, height))
    for picture in pictures:
        writer.write(picture)
        writer.write(cv2.GaussianBlur(picture, (0, 0), 4))
        writer.write(picture)
    writer.release()
    return path


@pytest.fixture
def cache(clip: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache that the tests share: four frames of the clip and their cameras are found once."""
    cache = clip.with_name("cache")
    monkeypatch.setenv("STEREOGS_CACHE", str(cache))
    return cache


@pytest.mark.proof
def test_a_video_is_a_scene_of_its_sharp_frames(
    clip: Path,
    cache: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["check", str(clip), "--set", "frames=4"]) == 0
    assert "fern clip, read by the scene loader video" in capsys.readouterr().out
    scene = build(VideoScene, path=clip, frames=4).load()
    assert (scene.name, scene.fact("source"), scene.test) == ("fern clip", "fern clip", ())
    numbers = [int(view.name.removeprefix("frame_")) for view in scene.train]
    assert scene.fact("frames_of_the_video") == ", ".join(f"{n:06d}" for n in numbers)
    assert len({number // COPIES for number in numbers}) == 4, "four different photographs"
    assert all(number % COPIES != 1 for number in numbers), "no blurred one"
    assert [*(cache / "frames").iterdir()] != []


def test_short_time_takes_fewer_frames_unless_their_cameras_may_be_known(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path))
    asked = build(VideoScene, path=clip, frames=9).settings
    taken = [VideoScene.within(asked, seconds).frames for seconds in (0, 41, 44, 300)]
    assert taken == [6, 8, 8, 9]
    (tmp_path / "chosen").mkdir()
    video_file._extract(clip, 9, tmp_path / "chosen")
    assert VideoScene.within(asked, 0).frames == 9
    large = tmp_path / "large.mp4"
    writer = cv2.VideoWriter(str(large), cv2.VideoWriter.fourcc(*"mp4v"), 10, (960, 720))
    writer.write(np.zeros((720, 960, 3), np.uint8))
    writer.release()
    hasty = VideoScene.within(build(VideoScene, path=large).settings, 30)
    assert (hasty.frames, hasty.matching_size) == (6, 688), "fewer frames, then smaller ones"
    missing = build(VideoScene, path=tmp_path / "missing.mp4").settings
    assert VideoScene.within(missing, 0) is missing


def test_an_error_names_the_video(clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video_file, "_extract", lambda *_: None)
    with pytest.raises(SceneError, match="the folder has 0") as caught:
        build(VideoScene, path=clip).load()
    assert caught.value.where == str(clip)
    assert "scene.frames=" in caught.value.fix


def test_files_that_are_no_videos(tmp_path: Path) -> None:
    text = tmp_path / "notes.mp4"
    text.write_text("no video")
    assert VideoScene.recognizes(text)
    assert not VideoScene.recognizes(tmp_path)
    with pytest.raises(SceneError, match="cannot be read as a video"):
        build(VideoScene, path=text).load()
    with pytest.raises(SceneError, match="does not exist"):
        build(VideoScene, path=tmp_path / "missing.mp4").load()


def written(path: Path, frames: list[NDArray[np.uint8]]) -> Path:
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30, (width, height))
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path


def moving(count: int) -> list[NDArray[np.uint8]]:
    """Frames of a camera that moves past a wall."""
    small = np.random.default_rng(0).integers(0, 256, (30, 40 + count), dtype=np.uint8)
    wall = np.asarray(cv2.resize(small, None, None, 8, 8, cv2.INTER_CUBIC), dtype=np.uint8)
    return [np.repeat(wall[:, 8 * k : 8 * k + 320, None], 3, axis=2) for k in range(count)]


def test_repeated_frames_are_chosen_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """24 frames a second stored as 30, and a recording whose camera rests."""
    monkeypatch.setenv("STEREOGS_CACHE", "")
    frames = moving(8)
    pulldown = [frame for k, frame in enumerate(frames) for _ in range(2 if k % 4 == 0 else 1)]
    video_file._extract(written(tmp_path / "a.mp4", pulldown), 20, tmp_path)
    assert len([*tmp_path.glob("frame_*.png")]) == len(frames)
    with pytest.raises(SceneError, match="only 2 frames of the video differ"):
        video_file._extract(
            written(tmp_path / "b.mp4", frames[:1] * 20 + frames[7:] * 20), 5, tmp_path
        )


def test_frames_are_spaced_by_motion() -> None:
    """A camera that rests for half of the clip and then moves evenly."""
    rests = [Candidate(number, 1.0, 0.0) for number in range(50)]
    moves = [Candidate(number, 1.0, 0.01) for number in range(50, 100)]
    numbers = chosen_frames(rests + moves, 10)
    assert len(numbers) == 10
    assert sum(number < 50 for number in numbers) <= 1


def test_the_sharpest_frame_of_each_part_is_chosen() -> None:
    frames = [Candidate(number, float(number % 7 == 3), 0.01) for number in range(100)]
    assert all(number % 7 == 3 for number in chosen_frames(frames, 5))


def test_all_frames_of_a_short_clip_are_chosen() -> None:
    frames = [Candidate(10 * number, 1.0, 0.0) for number in range(4)]
    assert chosen_frames(frames, 5) == [0, 10, 20, 30]


@pytest.mark.proof
def test_the_contract(clip: Path, cache: Path) -> None:
    check(VideoScene, path=clip, frames=4)
