"""File names in camera files, names of views, and limits on documents."""

from __future__ import annotations

from pathlib import Path

import pydantic
import pytest

from registry import SceneError
from registry.toolkit.photos import inside, list_images, read_document, view_names


@pytest.mark.parametrize(
    "name", ["", ".", "/a", "../a", "a/../../b", "C:/a", "..\\a", "a\0", "a\nb", "x" * 300]
)
def test_names_that_leave_the_folder(name: str, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="does not stay inside"):
        inside(tmp_path, name, "here")


def test_names_that_stay(tmp_path: Path) -> None:
    for name in ("./a/b c.png", "a\\b c.png", str(tmp_path / "a" / "b c.png")):
        assert inside(tmp_path, name, "") == tmp_path / "a" / "b c.png"


def test_view_names_are_stems_unless_they_repeat() -> None:
    assert view_names(["a/1.png", "a/2.png"]) == ["1", "2"]
    assert view_names(["a/1.png", "b/1.png"]) == ["a_1", "b_1"]


def test_links_may_not_leave_the_folder(tmp_path: Path) -> None:
    scene, outside = tmp_path / "scene", tmp_path / "outside"
    for folder in (scene, outside):
        folder.mkdir()
        (folder / "a.png").touch()
    (scene / "out.png").symlink_to(outside / "a.png")
    (scene / "folder").symlink_to(outside)
    (scene / "within.png").symlink_to("a.png")
    for name in ("out.png", "out", "folder/a.png", "folder/a"):  # suffixes are optional
        with pytest.raises(SceneError, match="outside the scene's folder"):
            inside(scene, name, "here")
    assert inside(scene, "within.png", "") == scene / "within.png"
    (tmp_path / "link").symlink_to(scene)  # the scene's folder itself may be a link
    assert inside(tmp_path / "link", "a.png", "") == tmp_path / "link" / "a.png"


class Document(pydantic.BaseModel):
    number: int


def test_documents_are_regular_files_of_limited_size(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text('{"number": 3}')
    assert read_document(path, Document, "").number == 3
    path.write_text('{"number": 3, "more": [' + "0," * 6_000_000 + "0]}")
    with pytest.raises(SceneError, match="bytes, more than 12,000,000"):
        read_document(path, Document, "")
    path.write_text("[" * 100_000)
    with pytest.raises(SceneError, match="cannot be read"):
        read_document(path, Document, "")
    with pytest.raises(SceneError, match="is not a regular file"):
        read_document(Path("/dev/zero"), Document, "")


@pytest.mark.parametrize(
    "text", ['{"number": 3, "number": 4}', '{"number": 3, "inner": [{"a": 1, "a": 1}]}']
)
def test_a_field_that_occurs_twice_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(SceneError, match=r"a\.json has the field '(number|a)' twice"):
        read_document(path, Document, "")


def test_hidden_images_are_not_listed(tmp_path: Path) -> None:
    for name in ("a.jpg", "._a.jpg"):
        (tmp_path / name).touch()
    assert [path.name for path in list_images(tmp_path)] == ["a.jpg"]
