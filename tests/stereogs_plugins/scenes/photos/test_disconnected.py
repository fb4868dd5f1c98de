"""Error messages for photographs whose cameras do not connect."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from registry import SceneError
from registry.toolkit.photos import ColmapModel
from stereogs_plugins.scenes.photos import disconnected
from stereogs_plugins.scenes.photos.disconnected import largest_group
from stereogs_plugins.scenes.photos.found_cameras import FoundCameras
from stereogs_plugins.scenes.photos.mapping import Piece
from stereogs_plugins.scenes.photos.no_depth import Doubt
from stereogs_plugins.scenes.photos.structure_from_motion import Reconstruction

from .photographs import MATCHES, load

NAMES = ("a.jpg", "b.jpg", "c.jpg", "d.jpg", "e.jpg")


class TestExplanation:
    def explain(
        self,
        pieces: list[list[int]],
        features: tuple[int, ...] = (900,) * len(NAMES),
        matches: dict[tuple[int, int], int] = MATCHES,
        doubts: dict[tuple[int, int], Doubt] | None = None,
    ) -> SceneError:
        models = [Piece(Path(), piece) for piece in pieces]
        found = Reconstruction(models, matches, list(features), doubts=doubts or {})
        model = ColmapModel({}, [], [], Path()) if pieces else None
        with pytest.raises(SceneError) as caught:
            largest_group(FoundCameras(found, model), NAMES, "folder", require_all=True)
        return caught.value

    def test_groups_matches_and_the_picture_between(self) -> None:
        error = self.explain([[0, 1, 2], [3, 4]])
        assert "3 of 5 photographs" in error.what
        assert "group 1: a.jpg, b.jpg, c.jpg" in error.what
        assert "group 2: d.jpg, e.jpg" in error.what
        assert "    c.jpg  b.jpg 150, a.jpg 90, d.jpg 12" in error.what.splitlines()
        assert "between d.jpg and c.jpg, which share only 12 matches" in error.fix
        assert error.what.splitlines()[-1] == "  matched by SIFT"

    def test_a_photograph_that_two_pieces_have_is_counted_once(self) -> None:
        assert "group 2: d.jpg, e.jpg" in self.explain([[0, 1, 2], [2, 3, 4]]).what

    def test_photographs_without_a_piece_are_grouped_by_matches(self) -> None:
        assert "group 2: d.jpg, e.jpg" in self.explain([[0, 1, 2]]).what

    def test_photographs_without_any_match(self) -> None:
        error = self.explain([[0, 1, 2]], matches={(0, 1): 200, (1, 2): 150})
        assert "group 3: e.jpg" in error.what
        assert "    e.jpg  none" in error.what.splitlines()
        assert "d.jpg, e.jpg have no matches with the largest group" in error.fix
        assert error.fix.count("no matches") == 1

    def test_a_blurred_photograph(self) -> None:
        error = self.explain([[0, 1, 2, 3]], (900, 900, 900, 900, 17))
        assert "take e.jpg again: 17 details" in error.fix

    def test_advice_for_many_matches(self) -> None:
        error = self.explain([[0, 1, 2, 3]], matches=MATCHES | {(3, 4): 1660})
        assert "e.jpg shares 1,660 matches with d.jpg" in error.fix
        assert "only" not in error.fix

    def test_without_matches_or_pieces(self) -> None:
        error = self.explain([], matches={(0, 1): 12})
        assert "no two of the 5 photographs overlap" in error.what
        assert "group" not in error.what

    def test_pictures_that_contradict_matches(self) -> None:
        error = self.explain(
            [[0, 1, 2]], matches=MATCHES | {(2, 3): 90}, doubts={(2, 3): "pictures"}
        )
        assert (
            "d.jpg shares 90 matches with c.jpg, but what surrounds the matches differs"
            in error.fix
        )

    def test_pictures_from_one_position(self) -> None:
        pairs = [(0, 1), (0, 2), (1, 2), (3, 4)]
        error = self.explain([], doubts=dict.fromkeys(pairs, "position"))
        assert "200 matches, but they were taken from one position" in error.what
        assert "do not turn on the spot" in error.fix

    def test_matches_without_depth(self) -> None:
        error = self.explain([], matches={(0, 1): 1660})
        assert "share up to 1,660 matches" in error.what
        assert "overlap" not in str(error)
        assert "step to the side" in error.fix

    def test_one_piece_is_accepted(self) -> None:
        found = Reconstruction([Piece(Path(), [0, 1, 2, 3, 4])], MATCHES, [900] * 5)
        model = ColmapModel({}, [], [], Path())
        cameras = FoundCameras(found, model)
        assert largest_group(cameras, NAMES, "folder", require_all=True) == (model, {})

    def test_photographs_outside_the_largest_group_have_reasons(self) -> None:
        found = Reconstruction([Piece(Path(), [0, 1, 2])], MATCHES, [900] * 5)
        model = ColmapModel({}, [], [], Path())
        cameras = FoundCameras(found, model)
        used, reasons = largest_group(cameras, NAMES, "folder", require_all=False)
        assert used is model
        assert list(reasons) == [3, 4]
        assert "take a picture between d.jpg and c.jpg" in reasons[4]

    def test_two_photographs_are_too_few(self) -> None:
        found = Reconstruction([Piece(Path(), [0, 1])], MATCHES, [900] * 5)
        cameras = FoundCameras(found, ColmapModel({}, [], [], Path()))
        with pytest.raises(SceneError, match="2 of 5 photographs"):
            largest_group(cameras, NAMES, "folder", require_all=False)

    @pytest.mark.parametrize("available", [False, True])
    def test_networks_are_suggested_if_they_are_missing(
        self, available: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        files = (Path("a"), Path("b")) if available else None
        monkeypatch.setattr(disconnected, "known_files", lambda: files)
        assert ("ALIKED and LightGlue" in self.explain([[0, 1, 2]]).fix) is not available


@pytest.mark.proof
def test_a_photograph_of_something_else_is_left_out(
    folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    from skimage import data

    copy = shutil.copytree(folder, tmp_path / "mixed")
    (copy / "train_01.jpg").unlink()
    Image.fromarray(data.coffee()).resize((360, 270)).save(copy / "coffee.png")
    with pytest.raises(SceneError) as caught:
        load(copy, require_all_photos=True)
    assert "the cameras of 4 of 5 photographs fit together" in caught.value.what
    assert "group 2: coffee.png" in caught.value.what
    assert "coffee.png" in caught.value.fix
    scene = load(copy)
    assert len(scene.train) == 4
    assert scene.fact("disconnected_photographs") == "coffee.png"
    assert "coffee.png: " in caplog.text


def test_photographs_without_overlap(tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    for index in range(3):
        pixels = generator.integers(0, 256, (120, 160, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(tmp_path / f"{index}.png")
    with pytest.raises(SceneError, match="no two of the 3 photographs overlap"):
        load(tmp_path)
