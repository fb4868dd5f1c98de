"""PLY files: bit-exact round trips, and errors for invalid files."""

from __future__ import annotations

import gzip
import logging
import math
import os
import resource
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from core_rasterizer import Gaussians, PlyError
from core_rasterizer.layout import PARAMETERS
from core_rasterizer.ply import load_ply, load_points, save_ply
from tests.core_rasterizer.scenes import random_gaussians


def gaussians_of(count: int, degree: int) -> Gaussians:
    return random_gaussians(count, degree, count + degree)


def rewritten(source: Path, target: Path, *, text: bool = False, drop: str = "") -> Path:
    """The same vertices, properties reversed, as text or without one property."""
    rows = PlyData.read(str(source))["vertex"].data
    names = [name for name in reversed(rows.dtype.names) if name != drop]
    other = np.empty(len(rows), dtype=[(name, "f4") for name in names])
    for name in names:
        other[name] = rows[name]
    PlyData([PlyElement.describe(other, "vertex")], text=text).write(str(target))
    return target


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    path = tmp_path / "scene.ply"
    save_ply(gaussians_of(7, 3), path)
    return path


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [0, 1, 50])
def test_round_trip_keeps_every_bit(tmp_path: Path, count: int, degree: int) -> None:
    gaussians = gaussians_of(count, degree)
    assert save_ply(gaussians, tmp_path / "scene.ply") == 0
    loaded = load_ply(tmp_path / "scene.ply")
    for field in PARAMETERS:
        assert torch.equal(getattr(loaded, field), getattr(gaussians, field)), field
    assert [p.name for p in tmp_path.iterdir()] == ["scene.ply"]


def test_the_layout_is_the_standard_one(tmp_path: Path) -> None:
    gaussians = gaussians_of(3, 1)
    save_ply(gaussians, tmp_path / "scene.ply")
    data = PlyData.read(str(tmp_path / "scene.ply"))
    rows = data["vertex"].data
    expected = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 " + " ".join(f"f_rest_{i}" for i in range(9))
    expected += " opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
    assert " ".join(rows.dtype.names) == expected
    assert (data.byte_order, data.text) == ("<", False)
    assert data.comments == ["SplatRenderMode: default"]
    assert not rows["nx"].any()
    # Channel-major: red has f_rest_0..2, green 3..5, blue 6..8.
    np.testing.assert_array_equal(rows["f_rest_4"], gaussians.sh[:, 2, 1].numpy())
    np.testing.assert_array_equal(rows["rot_0"], gaussians.quaternions[:, 0].numpy())


@pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
def test_order_of_properties_does_not_matter(tmp_path: Path, scene_file: Path, text: bool) -> None:
    loaded = load_ply(rewritten(scene_file, tmp_path / "other.ply", text=text))
    original = gaussians_of(7, 3)
    for field in PARAMETERS:
        torch.testing.assert_close(getattr(loaded, field), getattr(original, field))


def test_rows_that_are_not_finite_are_omitted_and_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    gaussians = gaussians_of(6, 1)
    gaussians.means[1, 2] = math.nan
    gaussians.sh[4, 3, 0] = math.inf
    with caplog.at_level(logging.WARNING):
        assert save_ply(gaussians, tmp_path / "scene.ply") == 2
    assert "2 of 6" in caplog.text
    assert torch.equal(load_ply(tmp_path / "scene.ply").means, gaussians.means[[0, 2, 3, 5]])


def test_a_failed_save_leaves_the_old_file(scene_file: Path) -> None:
    before = scene_file.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before), limits[1]))  # as good as a full disk
    try:
        with pytest.raises(PlyError, match="cannot be written"):
            save_ply(gaussians_of(1000, 3), scene_file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert scene_file.read_bytes() == before
    assert [p.name for p in scene_file.parent.iterdir()] == [scene_file.name]


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(PlyError, match="nowhere"):
        save_ply(gaussians_of(1, 0), tmp_path / "nowhere" / "scene.ply")


def test_a_missing_file_and_a_folder_raise(tmp_path: Path) -> None:
    for path in (tmp_path / "absent.ply", tmp_path):
        with pytest.raises(PlyError, match="cannot be opened"):
            load_ply(path)


@pytest.mark.parametrize("kept", [0.0, 0.1, 0.5, 0.999])
def test_a_truncated_file_raises(scene_file: Path, kept: float) -> None:
    content = scene_file.read_bytes()
    scene_file.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(PlyError, match=r"truncated|damaged"):
        load_ply(scene_file)


def test_truncated_text_raises(tmp_path: Path, scene_file: Path) -> None:
    path = rewritten(scene_file, tmp_path / "text.ply", text=True)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(PlyError):
        load_ply(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x89PNG\r\n\x1a\n" + bytes(100), "header"),
        (b"ply\nformat ascii 1.0\nelement face 0\nproperty int a\nend_header\n", "'vertex'.*face"),
        (
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
            "no y, z, f_dc_0",
        ),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000000000\n"
            b"property float x\nend_header\n",
            "declares at least 16000000000000000 bytes",
        ),
        (b"ply\nformat ascii 1.0\nelement vertex -5\nproperty float x\nend_header\n", "vertex -5"),
        (
            b"ply\nformat utf7 1.0\nelement vertex 0\nproperty float x\nend_header\n",
            "cannot be read",
        ),
        (
            b"ply\nformat ascii 1.0\nelement vertex 0\nproperty \xff x\nend_header\n",
            "cannot be read",
        ),
    ],
    ids=[
        "png",
        "no-vertex",
        "point-cloud",
        "absurd-count",
        "negative-count",
        "format",
        "not-ascii",
    ],
)
def test_files_that_are_not_scenes_raise(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "attack.ply"
    path.write_bytes(content)
    with pytest.raises(PlyError, match=message) as caught:
        load_ply(path)
    assert str(path) in caught.value.where


def test_a_missing_property_is_named(tmp_path: Path, scene_file: Path) -> None:
    with pytest.raises(PlyError, match="no rot_2"):
        load_ply(rewritten(scene_file, tmp_path / "other.ply", drop="rot_2"))
    with pytest.raises(PlyError, match="44 f_rest properties, including f_rest_44"):
        load_ply(rewritten(scene_file, tmp_path / "other.ply", drop="f_rest_7"))


@pytest.mark.parametrize("name", ["f_rest_01", "f_rest_1" + "0" * 5000])
def test_an_invalid_f_rest_number_raises(scene_file: Path, name: str) -> None:
    content = scene_file.read_bytes().replace(b" f_rest_1\n", f" {name}\n".encode(), 1)
    scene_file.write_bytes(content)
    with pytest.raises(PlyError, match=f"45 f_rest properties, including {name[:40]}\n"):
        load_ply(scene_file)


def test_bands_with_padded_numbers_are_not_lost(scene_file: Path) -> None:
    content = scene_file.read_bytes()
    for number in range(45):
        content = content.replace(f" f_rest_{number}\n".encode(), f" f_rest_{number:03}\n".encode())
    scene_file.write_bytes(content)
    with pytest.raises(PlyError, match="45 f_rest properties, including f_rest_044"):
        load_ply(scene_file)


def test_a_value_that_is_not_finite_is_named(scene_file: Path) -> None:
    rows = np.array(PlyData.read(str(scene_file))["vertex"].data)
    rows["scale_1"][5] = math.nan
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(scene_file))
    with pytest.raises(PlyError, match=r"scale_1 .* vertex 5") as caught:
        load_ply(scene_file)
    assert caught.value.where.endswith("scale_1[5]")


def test_infinite_opacities_are_opaque_and_transparent(scene_file: Path) -> None:
    rows = np.array(PlyData.read(str(scene_file))["vertex"].data)
    rows["opacity"][[2, 4]] = math.inf, -math.inf
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(scene_file))
    opacities = torch.sigmoid(load_ply(scene_file).opacity_logits)
    assert opacities[2] == 1
    assert 0 < opacities[4] < 1e-12


def with_header(scene_file: Path, old: str, new: str) -> Path:
    content = scene_file.read_bytes()
    assert old.encode() in content
    scene_file.write_bytes(content.replace(old.encode(), new.encode(), 1))
    return scene_file


def test_comments_need_not_be_ascii(scene_file: Path) -> None:
    before = load_ply(scene_file)
    element = "element vertex"
    path = with_header(scene_file, element, f"comment caf\u00e9\nobj_info \u5730\n{element}")
    torch.testing.assert_close(load_ply(path).means, before.means, rtol=0, atol=0)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("SplatRenderMode: default", "SplatRenderMode: mip", "compensate_dilation"),
        ("property float nx", "property float filter_3D", "compensate_dilation"),
        ("property float nx", "property float trbf_center", "moves in time (trbf_center)"),
        ("end_header", "element delta_vertex_0 0\nend_header", "moves in time (delta_vertex_0)"),
    ],
    ids=["comment", "property", "motion", "frames"],
)
def test_what_a_plain_rendering_lacks_is_mentioned(
    old: str, new: str, said: str, scene_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    load_ply(scene_file)
    assert not caplog.text
    load_ply(with_header(scene_file, old, new))
    assert said in caplog.text


def test_scenes_of_other_kinds_are_named(tmp_path: Path, scene_file: Path) -> None:
    flat = rewritten(scene_file, tmp_path / "flat.ply", drop="scale_2")
    packed = tmp_path / "packed.ply"
    names = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
    rows = np.zeros(3, dtype=[(name, "u4") for name in names])
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(packed))
    splat = tmp_path / "scene.splat"
    splat.write_bytes(bytes(64))
    zipped = tmp_path / "zipped.ply"
    zipped.write_bytes(gzip.compress(flat.read_bytes()))
    anchors = Path(shutil.copy(scene_file, tmp_path / "anchors.ply"))
    with_header(anchors, "f_dc_0", "f_anchor_feat_0")
    named = [(flat, "2DGS"), (packed, "SuperSplat"), (splat, "antimatter15"), (zipped, "gzip")]
    named.append((anchors, "Scaffold-GS"))
    for path, what in named:
        with pytest.raises(PlyError, match=what) as caught:
            load_ply(path)
        assert caught.value.fix


def test_a_list_property_raises(tmp_path: Path, scene_file: Path) -> None:
    path = rewritten(scene_file, tmp_path / "text.ply", text=True)
    content = path.read_text().replace("property float opacity", "property list uchar int opacity")
    path.write_text(content)
    with pytest.raises(PlyError):
        load_ply(path)


POINTS = "ply\nformat {} 1.0\nelement vertex 2\n{}{}end_header\n"
POSITION = "property float x\nproperty float y\nproperty float z\n"
WHOLE = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
BROKEN = "property float red\nproperty float green\nproperty float blue\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (POINTS.format("ascii", POSITION, WHOLE) + "0 0 0 1 2 300\n0 0 0 1 2 3\n", "300"),
        (POINTS.format("ascii", POSITION, BROKEN) + "0 0 0 0 0 127.5\n0 0 0 0 0 1\n", "127.5"),
        (
            POINTS.format("ascii", POSITION, BROKEN) + "0 0 0 0 0 -0.5\n0 0 0 0 0 1\n",
            "not in 0 to 1",
        ),
        (POINTS.format("ascii", POSITION, WHOLE) + "0 0 0 1 2 3\n" * 3, "2 rows, .* has 3"),
        (
            POINTS.format("ascii", POSITION, WHOLE).replace("x 2", "x " + "9" * 5000),
            "without a count",
        ),
        (
            POINTS.format("binary_little_endian", POSITION, WHOLE) + "\0" * 31,
            "declares 30 bytes, but the file has 31",
        ),
        (
            POINTS.format("binary_little_endian", POSITION, WHOLE + "property list uchar int a\n")
            + "\0" * 40,
            "list properties in or before",
        ),
    ],
    ids=["too-large", "colours-up-to-255", "dark", "rows", "digits", "trailing", "list"],
)
def test_invalid_points_raise(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "points.ply"
    path.write_text(content)
    with pytest.raises(PlyError, match=message):
        load_points(path)


def test_faces_are_skipped(tmp_path: Path) -> None:
    faces = 200_000  # to read them takes seconds, and a hundred times the memory
    header = POINTS.format("binary_little_endian", POSITION, WHOLE).replace(
        "end_header", f"element face {faces}\nproperty list uchar int vertex_indices\nend_header"
    )
    path = tmp_path / "mesh.ply"
    path.write_bytes(header.encode() + bytes(30) + bytes(faces))
    start = time.monotonic()
    positions, _ = load_points(path)
    assert time.monotonic() - start < 1
    assert positions.shape == (2, 3)


def test_a_pipe_is_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.ply")
    for path in (tmp_path / "pipe.ply", Path("/dev/zero")):
        with pytest.raises(PlyError, match="cannot be opened"):
            load_points(path)
