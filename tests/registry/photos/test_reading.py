"""Names in camera files: those that leave the scene's folder, and what views are called."""

from __future__ import annotations

from pathlib import Path

import pytest

from registry import SceneError
from registry.photos import inside, view_names


@pytest.mark.parametrize(
    "name", ["", ".", "/a", "../a", "a/../../b", "C:/a", "a\\b", "a\0", "a\nb", "x" * 300]
)
def test_names_that_leave_the_folder(name: str, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="does not stay inside"):
        inside(tmp_path, name, "here")


def test_names_that_stay(tmp_path: Path) -> None:
    assert inside(tmp_path, "./a/b c.png", "") == tmp_path / "a" / "b c.png"


def test_view_names_are_stems_unless_they_repeat() -> None:
    assert view_names(["a/1.png", "a/2.png"]) == ["1", "2"]
    assert view_names(["a/1.png", "b/1.png"]) == ["a_1", "b_1"]
