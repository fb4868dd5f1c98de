"""Error messages for photographs whose cameras do not connect."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from registry import SceneError
from registry.toolkit.photos import ColmapModel
from stereogs_plugins.scenes.photos import disconnected
from stereogs_plugins.scenes.photos.disconnected import LargestGroup, largest_group
from stereogs_plugins.scenes.photos.found_cameras import FoundCameras
from stereogs_plugins.scenes.photos.photogrammetry.mapping import Piece
from stereogs_plugins.scenes.photos.photogrammetry.structure_from_motion import Reconstruction
from stereogs_plugins.scenes.photos.photogrammetry.two_view import Doubt
from stereogs_plugins.scenes.photos.picture_files import reason_lines
from tests.stereogs_plugins.scenes.photos.photographs import MATCHES, load

NAMES = ("a.jpg", "b.jpg", "c.jpg", "d.jpg", "e.jpg")


MODEL = ColmapModel({}, [], [], Path())


def group_of(
    pieces: list[list[int]],
    matches: dict[tuple[int, int], int] = MATCHES,
    features: Sequence[int] = (900,) * len(NAMES),
    doubts: dict[tuple[int, int], Doubt] | None = None,
    names: Sequence[str] = NAMES,
    *,
    require_all: bool = False,
) -> LargestGroup:
    """The largest group of photographs with these pieces."""
    models = [Piece(Path(), piece) for piece in pieces]
    found = Reconstruction(models, matches, list(features), doubts=doubts or {})
    cameras = FoundCameras(found, MODEL if pieces else None)
    return largest_group(cameras, names, "folder", require_all=require_all)


class TestExplanation:
    def explain(self, *args: Any, **kwargs: Any) -> SceneError:
        with pytest.raises(SceneError) as caught:
            group_of(*args, **kwargs, require_all=True)
        return caught.value

    def test_the_reason_the_pairs_and_the_picture_between(self) -> None:
        error = self.explain([[0, 1, 2], [3, 4]])
        assert error.what.splitlines() == [
            "only 3 of 5 photographs connect, and all are required",
            "  d.jpg, e.jpg: at most 12 matches with those that connect, too few for a camera",
            "  tried SIFT; most matches: d.jpg - e.jpg 80, c.jpg - d.jpg 12, b.jpg - d.jpg 9",
        ]
        assert "if they show the same scene, take pictures between c.jpg and d.jpg" in error.fix
        assert error.fix.splitlines()[-1] == f"more: {disconnected.PAGE}"

    def test_photographs_without_any_match(self) -> None:
        error = self.explain([[0, 1, 2]], matches={(0, 1): 200, (1, 2): 150})
        assert "  d.jpg, e.jpg: no matches with those that connect" in error.what.splitlines()
        assert "between c.jpg and d.jpg" in error.fix, "neighbours by name"

    def test_many_photographs_have_one_line(self) -> None:
        names = [f"{k:02}.jpg" for k in range(20)]
        group = group_of([[*range(9)]], {(0, 19): 24, (2, 12): 42}, [900] * 20, names=names)
        assert reason_lines(group.left_out, names) == [
            "  09.jpg, 10.jpg, 11.jpg, 12.jpg, 13.jpg and 6 more: at most 42 matches with those "
            "that connect, too few for a camera"
        ]
        assert "between 02.jpg and 12.jpg" in group.advice

    def test_a_blurred_photograph(self) -> None:
        error = self.explain([[0, 1, 2, 3]], features=(900, 900, 900, 900, 17))
        assert "  e.jpg: nearly no details" in error.what
        assert "take e.jpg again" in error.fix

    def test_advice_for_many_matches(self) -> None:
        error = self.explain([[0, 1, 2, 3]], matches=MATCHES | {(3, 4): 1660})
        assert "e.jpg: many matches with those that connect, but they contradict" in error.what
        assert "something moved in e.jpg" in error.fix
        assert "between" not in error.fix

    def test_without_matches_or_pieces(self) -> None:
        error = self.explain([], matches={(0, 1): 12})
        assert "no two of the 5 photographs overlap" in error.what
        assert "group" not in error.what

    def test_pictures_that_contradict_matches(self) -> None:
        error = self.explain(
            [[0, 1, 2]], matches=MATCHES | {(2, 3): 90}, doubts={(2, 3): "pictures"}
        )
        assert (
            "  d.jpg: matches with those that connect, but what surrounds the matches differs"
            in error.what
        )
        assert "  e.jpg: no matches with those that connect" in error.what
        assert "take pictures between them" in error.fix

    def test_pictures_from_one_position(self) -> None:
        pairs = [(0, 1), (0, 2), (1, 2), (3, 4)]
        error = self.explain([], doubts=dict.fromkeys(pairs, "position"))
        assert "200 matches, but they were taken from one position" in error.what
        assert "do not turn on the spot" in error.fix
        assert "ALIKED" not in error.fix, "networks add no depth"

    def test_matches_without_depth(self) -> None:
        error = self.explain([], matches={(0, 1): 1660})
        assert "share up to 1,660 matches" in error.what
        assert "overlap" not in str(error)
        assert "step to the side" in error.fix

    def test_two_photographs_depend_on_their_focal_length(self) -> None:
        with pytest.raises(SceneError, match="correct the focal length in EXIF if it is wrong"):
            group_of([], {(0, 1): 1660}, [900] * 2, names=NAMES[:2])

    def test_one_piece_is_accepted(self) -> None:
        assert group_of([[0, 1, 2, 3, 4]], require_all=True) == (MODEL, {}, "")

    def test_photographs_outside_the_largest_group_have_reasons(self) -> None:
        group = group_of([[0, 1, 2]])
        assert group.model is MODEL
        assert list(group.left_out) == [3, 4]

    def test_two_photographs_are_too_few(self) -> None:
        with pytest.raises(SceneError, match="2 of 5 photographs"):
            group_of([[0, 1]])

    @pytest.mark.parametrize("available", [False, True])
    def test_networks_are_suggested_if_they_are_missing(
        self, available: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        files = (Path("a"), Path("b")) if available else None
        monkeypatch.setattr(disconnected, "known_files", lambda: files)
        assert ("ALIKED and LightGlue" in self.explain([[0, 1, 2]]).fix) is not available


def test_photographs_without_overlap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("STEREOGS_MODELS", raising=False)
    generator = np.random.default_rng(0)
    for index in range(3):
        pixels = generator.integers(0, 256, (120, 160, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(tmp_path / f"{index}.png")
    with pytest.raises(SceneError, match="no two of the 3 photographs overlap"):
        load(tmp_path)
