"""Decoding, estimated bounds, file names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from core_rasterizer import Camera
from registry import PointCloud, SceneError
from stereogs_plugins.scenes._bounds import estimate_bounds
from stereogs_plugins.scenes._images import Decoder, at_most, divided_by, in_parallel
from stereogs_plugins.scenes._reading import inside, view_names


def looking_at_origin(angle: float, radius: float = 4.0) -> Camera:
    rotation = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    pose = np.eye(4)
    pose[:3, :3], pose[2, 3] = rotation, radius
    return Camera(torch.from_numpy(pose), 40, 40, 16, 12, 32, 24)


def test_bounds_from_visible_points() -> None:
    camera = looking_at_origin(0)
    depths = torch.linspace(2, 10, 1001)
    positions = torch.stack([torch.zeros(1001), torch.zeros(1001), depths - 4], dim=1)
    outside = torch.tensor([[50.0, 0, 0], [0, 0, -100]])  # beside the image, and behind
    positions = torch.cat([positions, outside])
    near, far = estimate_bounds([camera], PointCloud(positions, torch.zeros(1003, 3)), "")
    assert (near, far) == pytest.approx((2 / 1.1, 10 * 1.1), rel=0.01)


def test_bounds_from_what_cameras_look_at() -> None:
    cameras = [looking_at_origin(0.3, 4.0), looking_at_origin(-0.3, 6.0)]
    assert estimate_bounds(cameras, None, "") == pytest.approx((4 / 5, 6 * 5))


def test_bounds_from_baselines_of_parallel_cameras() -> None:
    poses = [torch.eye(4), torch.eye(4)]
    poses[1][0, 3] = 0.5
    cameras = [Camera(pose, 40, 40, 16, 12, 32, 24) for pose in poses]
    assert estimate_bounds(cameras, None, "") == pytest.approx((0.5, 50))


def test_cameras_that_look_apart_fall_back_to_baselines() -> None:
    away = [looking_at_origin(angle, -4.0) for angle in (0.3, -0.3)]
    near, far = estimate_bounds(away, None, "")
    assert far == pytest.approx(100 * near)


def test_one_camera_has_no_bounds() -> None:
    few = PointCloud(torch.zeros(3, 3), torch.zeros(3, 3))
    with pytest.raises(SceneError, match="nothing tells how deep"):
        estimate_bounds([looking_at_origin(0)], few, "here")


@pytest.mark.parametrize(
    ("mode", "color"), [("L", 100), ("RGB", (100, 100, 100)), ("P", 100), ("LA", (100, 255))]
)
def test_other_kinds_of_pixels_become_rgb(
    mode: str, color: int | tuple[int, ...], tmp_path: Path
) -> None:
    image = Image.new(mode, (4, 3), color)
    if mode == "P":
        image.putpalette([value for value in range(256) for _ in range(3)])
    image.save(tmp_path / "a.png")
    pixels = Decoder().read(tmp_path / "a.png")
    assert pixels.shape == (3, 4, 3)
    assert (pixels == 100).all()


def test_sixteen_bits_are_refused_not_clipped(tmp_path: Path) -> None:
    Image.fromarray(np.full((3, 4), 40000, dtype=np.uint16)).save(tmp_path / "a.png")
    with pytest.raises(SceneError, match="not 8 bits a channel"):
        Decoder().read(tmp_path / "a.png")


def test_sizes() -> None:
    assert divided_by(8)(4946, 3286) == (618, 411)
    assert divided_by(100)(8, 6) == (1, 1)
    assert at_most(400)(1600, 1200) == (400, 300)
    assert at_most(400)(399, 100) == (399, 100)


def test_the_filter_is_the_named_one(tmp_path: Path) -> None:
    columns = np.zeros((4, 8, 3), dtype=np.uint8)
    columns[:, ::2] = 200
    Image.fromarray(columns).save(tmp_path / "a.png")
    pixels = Decoder(size=divided_by(2), resize_filter="box").read(tmp_path / "a.png")
    assert (pixels == 100).all()
    other = Decoder(size=divided_by(2), resize_filter="bicubic").read(tmp_path / "a.png")
    assert (other != 100).any()


def test_parallel_work_keeps_its_order_and_its_errors() -> None:
    assert in_parallel(lambda value: value**2, range(50)) == [value**2 for value in range(50)]
    with pytest.raises(ZeroDivisionError):
        in_parallel(lambda value: 1 // value, [1, 0])
    assert in_parallel(lambda value: value, []) == []


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


def test_resized_photographs_are_kept_by_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    photograph = tmp_path / "a.png"
    noise = np.random.default_rng(0).integers(0, 256, (8, 8, 3), dtype=np.uint8)
    Image.fromarray(noise).save(photograph)
    half = Decoder(size=divided_by(2))
    fresh = half.read(photograph)
    (kept,) = (tmp_path / "cache" / "photographs").iterdir()
    np.testing.assert_array_equal(half.read(photograph), fresh)
    Image.new("RGB", (4, 4), (1, 2, 3)).save(kept)
    assert half.read(photograph)[0, 0].tolist() == [1, 2, 3]  # it was read, not computed
    kept.write_bytes(b"damaged")
    np.testing.assert_array_equal(half.read(photograph), fresh)
    assert "damaged" in caplog.text
    Decoder(size=divided_by(2), resize_filter="box").read(photograph)
    Image.fromarray(255 - noise).save(photograph)
    assert (half.read(photograph) != fresh).any()
    assert len(list((tmp_path / "cache" / "photographs").iterdir())) == 3


def test_a_cache_that_cannot_be_written_is_done_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "cache").write_text("a file, not a folder")
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    Image.new("RGB", (8, 8)).save(tmp_path / "a.png")
    assert Decoder(size=divided_by(2)).read(tmp_path / "a.png").shape == (4, 4, 3)
    assert "could not be cached" in caplog.text
