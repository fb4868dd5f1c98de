"""Undistortion by pycolmap, compared with kornia's model of the same lenses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from kornia.geometry.calibration import distort_points
from PIL import Image
from torch.nn.functional import grid_sample

from registry import SceneError
from registry.toolkit.photos import (
    Decoder,
    Distortion,
    Lens,
    LoadedPhotos,
    PosedPhoto,
    longest_side,
    undistort,
)
from registry.toolkit.photos.decoder import Pixels

WIDTH, HEIGHT = 160, 120


def waves() -> Pixels:
    """A smooth image whose bilinear samples determine their positions."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    channels = [np.sin(u / 9) + np.cos(v / 7), np.sin((u + v) / 11), np.cos(u / 13)]
    return (127.5 + 60 * np.stack(channels, axis=2)).astype(np.uint8)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("OPENCV", (-0.12, 0.02, 0.003, -0.002)),
        ("FULL_OPENCV", (-0.1, 0.03, 0.001, 0.002, 0.004, 0.01, -0.02, 0.001)),
    ],
)
def test_every_pixel_agrees_with_kornia(model: Distortion, coefficients: tuple[float, ...]) -> None:
    bent = Lens(130.0, 128.0, 82.0, 58.5, WIDTH, HEIGHT, model, coefficients)
    picture = waves()
    straight, pixels = undistort(bent, picture, "here")
    assert straight.is_pinhole
    v, u = torch.meshgrid(
        torch.arange(straight.height) + 0.5, torch.arange(straight.width) + 0.5, indexing="ij"
    )
    seen_at = distort_points(
        torch.stack([u, v], dim=-1).reshape(1, -1, 2).double(),
        calibration(bent),
        torch.tensor([coefficients], dtype=torch.float64),
        calibration(straight),
    )
    grid = (seen_at / torch.tensor([WIDTH, HEIGHT]) * 2 - 1).reshape(1, *u.shape, 2)
    image = torch.from_numpy(picture).double().permute(2, 0, 1)[None]
    expected = grid_sample(image, grid, align_corners=False, padding_mode="border")
    inner = (slice(2, -2), slice(2, -2))
    difference = expected[0].permute(1, 2, 0) - torch.from_numpy(pixels).double()
    assert difference[inner].abs().max() <= 1.0


def calibration(lens: Lens) -> torch.Tensor:
    matrix = [[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]]
    return torch.tensor([matrix], dtype=torch.float64)


def test_a_pinhole_image_is_unchanged() -> None:
    lens, picture = Lens(130.0, 128.0, 82.0, 58.5, WIDTH, HEIGHT), waves()
    assert undistort(lens, picture, "here") == (lens, picture)


def test_a_lens_that_bends_too_much_is_refused() -> None:
    bent = Lens(130.0, 128.0, 82.0, 58.5, WIDTH, HEIGHT, "OPENCV", (-3.0, 0.0, 0.0, 0.0))
    with pytest.raises(SceneError, match="bends the picture too much"):
        undistort(bent, waves(), "here")


@pytest.mark.parametrize("coefficient", [0.02, -0.02])
def test_undistorted_photographs_stay_sharp(coefficient: float, tmp_path: Path) -> None:
    path = tmp_path / "noise.png"
    noise = np.random.default_rng(0).integers(0, 256, (600, 800, 3), dtype=np.uint8)
    Image.fromarray(noise).save(path)
    contrasts = []
    for distortion in ((), (coefficient, 0.0, 0.0, 0.0)):
        lens = Lens(640.0, 640.0, 400.0, 300.0, 800, 600, "OPENCV", distortion)
        photo = PosedPhoto("noise", path, np.eye(4), lens, "here")
        views = LoadedPhotos.load([photo], Decoder(longest_side(200)), [0], []).views
        assert views[0].camera.fx == pytest.approx(160, rel=0.01)
        contrasts.append(float(views[0].image.std()))
    assert contrasts[1] == pytest.approx(contrasts[0], rel=0.12)


def test_a_camera_file_for_a_smaller_size_fits() -> None:
    lens = Lens(900.0, 900.0, 600.0, 452.0, 1200, 904)
    assert lens.resized(3200, 2409, "here").fx == 2400  # 4080x3072, rounded at both sizes
    with pytest.raises(SceneError, match="another shape"):
        lens.resized(3200, 2420, "here")


def test_each_axis_has_its_own_scale() -> None:
    small = Lens(101.0, 100.0, 50.5, 20.0, 101, 50).resized(50, 25, "here")
    assert (small.fx, small.fy, small.cx, small.cy) == pytest.approx((50, 50, 25, 10))
