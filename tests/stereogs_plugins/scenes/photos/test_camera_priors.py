"""Cameras of a prior: matches refine true ones, and refuse confident ones of anything else."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.ndimage import gaussian_filter  # type: ignore[attr-defined]
from scipy.spatial.transform import Rotation
from torch import Tensor

from core_rasterizer import open_device
from registry import Context, Scene, SceneError, Settings
from registry.priors import PosedDepth, PosedDepthPrior
from registry.toolkit.drawing import to_bytes
from stereogs_plugins.scenes.photos import PhotosScene, VideoScene
from stereogs_plugins.scenes.photos.loader import PhotosSettings
from stereogs_plugins.scenes.photos.photogrammetry import structure_from_motion, thresholds
from stereogs_plugins.scenes.photos.photogrammetry.matching import matchings
from tests.stereogs_plugins.scenes.photos.photographs import (
    COUNT,
    load,
    pose_errors,
    reconstruction_of,
)

UNIT = 7.0
Cameras = Callable[[int], tuple[Rotation, Any]]
"""Rotation, world to camera, and centre of a photograph by index."""


class Confident(PosedDepthPrior[Settings]):
    """Cameras as told, with dense depth and full confidence, whatever the photographs show."""

    cameras: Cameras
    focal = 0.8
    """In units of the longer side."""
    depth: Callable[[int, Tensor], Tensor]
    calls = 0

    def estimate(
        self, images: Sequence[Tensor], intrinsics: Sequence[Tensor | None]
    ) -> list[PosedDepth]:
        self.calls += 1
        return [self.view(k, image) for k, image in enumerate(images)]

    def view(self, index: int, image: Tensor) -> PosedDepth:
        height, width = image.shape[:2]
        rotation, center = self.cameras(index)
        pose = torch.eye(4, dtype=torch.float64)
        pose[:3, :3] = torch.from_numpy(rotation.as_matrix())
        pose[:3, 3] = torch.from_numpy(-rotation.as_matrix() @ center)
        focal = self.focal * max(height, width)
        lens = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        depth = self.depth(index, image)
        return PosedDepth(pose, lens, depth, torch.ones_like(depth))


class Pair(Confident):
    accepted_views = (2, 2)


def confident(
    cameras: Cameras,
    depth: Callable[[int, Tensor], Tensor] | None = None,
    kind: type[Confident] = Confident,
) -> Confident:
    prior = kind(Settings(), Context("network", 0, open_device()))
    prior.cameras = cameras
    prior.depth = depth or (lambda index, image: torch.full(image.shape[:2], 3.0))
    return prior


def in_a_row(index: int) -> tuple[Rotation, Any]:
    """Cameras side by side, as of a forward-facing scene."""
    return Rotation.identity(), np.array([0.3 * index, 0, 0])


def near(room: Scene, wrong: int | None = None) -> Confident:
    """The truth in another unit, with noise: two degrees, a tenth of the distance; and one wrong camera."""

    def cameras(index: int) -> tuple[Rotation, Any]:
        camera = room.train[index].camera
        random = np.random.default_rng(index)
        turn = random.normal(size=3)
        turn *= np.radians(90 if index == wrong else 2) / np.linalg.norm(turn)
        rotation = Rotation.from_matrix(camera.world_to_camera[:3, :3].numpy())
        center = camera.center.numpy() + 0.1 * random.normal(size=3)
        return Rotation.from_rotvec(turn) * rotation, UNIT * center

    def depth(index: int, image: Tensor) -> Tensor:
        known = room.train[index].depth
        assert known is not None
        rows, columns = (
            (torch.arange(side) * full) // side
            for side, full in zip(image.shape, known.shape, strict=False)
        )
        return UNIT * known[rows[:, None], columns]

    return confident(cameras, depth)


def loaded(folder: Path, *priors: Confident, **settings: Any) -> Scene:
    known = {prior.context.name: prior for prior in priors}
    context = Context("photos", 0, open_device(), priors=lambda base: known)
    small = {"path": folder, "max_size": 120, "matching_size": 240}
    return PhotosScene(PhotosSettings.model_validate(small | settings), context).load()


@pytest.fixture(autouse=True)
def _only_sift(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty cache; neither further kinds of matches nor dense refinement, which take most of the time."""
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(structure_from_motion, "matchings", lambda *given: matchings(*given)[:1])
    monkeypatch.setattr(thresholds, "MAX_REFINED", 0)


def test_matches_refine_the_cameras_of_a_prior(folder: Path, room: Scene) -> None:
    prior = near(room)
    scene = loaded(folder, prior, cameras="network")
    found, truth = ([view.camera for view in s.train] for s in (scene, room))
    rotations, directions = pose_errors(found, truth)
    assert rotations.max() < 0.5
    assert directions.max() < 0.5
    assert found[0].fx / found[0].width == pytest.approx(truth[0].fx / truth[0].width, rel=0.02)
    length, true = (float((c[0].center - c[4].center).norm()) for c in (found, truth))
    assert length == pytest.approx(UNIT * true, rel=0.02)
    assert scene.fact("cameras") == "of the prior 'network', refined by matches"
    # The cache has the cameras: neither the network nor the matching runs again.
    again = loaded(folder, prior, cameras="network")
    assert torch.equal(again.train[3].camera.world_to_camera, found[3].world_to_camera)
    assert prior.calls == 1


def test_a_wrong_camera_is_left_out_with_its_reason(
    folder: Path, room: Scene, caplog: pytest.LogCaptureFixture
) -> None:
    scene = loaded(folder, near(room, wrong=3), cameras="network")
    assert [view.name for view in scene.train] == ["train_00", "train_01", "train_02", "train_04"]
    assert "train_03.jpg: many matches with those that connect, but they contradict" in caplog.text
    rotations, _ = pose_errors(
        [view.camera for view in scene.train],
        [view.camera for view in room.train if view.name != "train_03"],
    )
    assert rotations.max() < 0.5


def textures(index: int) -> Any:
    """Unrelated pictures that have features."""
    noise = np.random.default_rng(index).normal(size=(120, 160, 3))
    smooth = gaussian_filter(noise, (1 + index, 1 + index, 0))
    return 128 + 50 * smooth / smooth.std()


def pure_noise(index: int) -> Any:
    return np.random.default_rng(index).uniform(0, 255, (120, 160, 3))


def crops(index: int) -> Any:
    """Parts of one picture, as cut out by hand: no copies, and no depth."""
    return (
        gaussian_filter(np.random.default_rng(0).uniform(0, 2000, (240, 320, 3)), (2, 2, 0))[
            10 * index : 10 * index + 180, 20 * index : 20 * index + 240
        ]
        / 8
    )


def flat(index: int) -> Any:
    return np.full((120, 160, 3), 60.0 * index)


@pytest.mark.parametrize(
    ("picture", "why"),
    [
        (textures, "no two of the 4 photographs overlap enough"),
        (pure_noise, "no two of the 4 photographs overlap enough"),
        (crops, "they show one flat surface"),
        (flat, "no two of the 4 photographs overlap enough"),
    ],
)
def test_confident_cameras_of_no_scene_are_refused(
    picture: Callable[[int], Any], why: str, tmp_path: Path
) -> None:
    folder = tmp_path / "pictures"
    folder.mkdir()
    for index in range(4):
        array = np.clip(picture(index), 0, 255).astype(np.uint8)
        Image.fromarray(array).save(folder / f"{index}.png")
    with pytest.raises(SceneError) as caught:
        loaded(folder, confident(in_a_row), cameras="network")
    assert "matches do not confirm the cameras of the prior 'network'" in caught.value.what
    assert why in caught.value.what
    assert caught.value.fix.startswith("leave out `cameras: network`")


def test_copies_of_a_photograph_do_not_reach_the_prior(room: Scene, tmp_path: Path) -> None:
    (tmp_path / "copies").mkdir()
    for index in range(4):
        picture = Image.fromarray(to_bytes(room.train[0].image))
        picture.save(tmp_path / "copies" / f"{index}.jpg", quality=80 + 5 * index)
    prior = confident(in_a_row)
    with pytest.raises(SceneError, match="needs at least 3 photographs"):
        loaded(tmp_path / "copies", prior, cameras="network")
    assert prior.calls == 0


def anywhere(index: int) -> tuple[Rotation, Any]:
    """Cameras that look in any direction."""
    return Rotation.random(random_state=index), np.random.default_rng(index).normal(size=3)


def test_wrong_cameras_are_refused_and_the_remedy_works(folder: Path) -> None:
    prior = confident(anywhere)
    with pytest.raises(
        SceneError, match=r"do not confirm .* but no depth follows from them"
    ) as caught:
        loaded(folder, prior, cameras="network")
    assert "leave out `cameras: network`" in caught.value.fix
    scene = loaded(folder, prior)
    assert len(scene.train) == COUNT
    assert scene.fact("cameras") == "found in the photographs by COLMAP"


@pytest.mark.parametrize("better", [True, False])
def test_a_prior_is_tried_for_photographs_that_do_not_connect(
    better: bool,
    folder: Path,
    entry: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", "")
    asked = []

    def reconstruct(photos: Any, decoder: Any, share: bool, empty: Path, estimate: Any) -> Any:
        asked.append(estimate)
        found = reconstruction_of(entry)
        part = found.pieces[0]._replace(members=[0, 1, 2, 4])
        return found if better and estimate else replace(found, pieces=[part])

    monkeypatch.setattr(structure_from_motion, "reconstruct", reconstruct)
    prior, pair = confident(in_a_row), confident(in_a_row, kind=Pair)
    with caplog.at_level(logging.INFO, logger="stereogs.photos"):
        scene = loaded(folder, prior)
    assert asked == [None, prior.posed_depths]
    assert ("prior" in str(scene.fact("cameras"))) == better
    assert f"those of {COUNT if better else COUNT - 1} of {COUNT} photographs" in caplog.text
    with caplog.at_level(logging.INFO, logger="stereogs.photos"):
        loaded(folder, pair)
    assert "the prior 'network' accepts 2 to 2 photographs, and got" in caplog.text
    assert len(asked) == 3


def test_a_prior_is_not_asked_if_matches_connect_all(folder: Path, entry: Path) -> None:
    def refuse(base: type) -> Any:
        raise AssertionError("asked for priors")

    context = Context("photos", 0, open_device(), priors=refuse)
    assert (
        len(PhotosScene(PhotosSettings.model_validate({"path": folder}), context).load().train)
        == COUNT
    )


def test_a_prior_that_is_not_there_or_does_not_accept_so_many_is_refused(folder: Path) -> None:
    with pytest.raises(SceneError, match=r"the prior 'network'.*is not installed"):
        load(folder, cameras="network")
    with pytest.raises(SceneError, match="accepts 2 to 2 photographs, and got 5") as caught:
        loaded(folder, confident(in_a_row, kind=Pair), cameras="network")
    assert "leave out `cameras: network`" in caught.value.fix


def test_photographs_and_videos_name_the_prior() -> None:
    for loader in (PhotosScene, VideoScene):
        settings = loader.Settings(path=Path("x"), cameras="network")  # type: ignore[call-arg]
        assert loader.priors_of(settings) == {"network": "posed_depth"}  # type: ignore[arg-type]
    assert PhotosScene.priors_of(PhotosSettings.model_validate({"path": Path("x")})) == {}
