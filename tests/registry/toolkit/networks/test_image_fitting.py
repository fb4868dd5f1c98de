"""Conversion of images to network sizes and back."""

from __future__ import annotations

import pytest
import torch

from registry.toolkit.networks.image_fitting import (
    Fit,
    Padding,
    contained,
    in_range,
    padded,
    stretched,
)


@pytest.mark.parametrize(
    ("image", "frozen", "content", "target"),
    [
        ((378, 504), (None, None), (378, 504), (384, 512)),
        ((384, 512), (None, None), (384, 512), (384, 512)),
        ((1, 1), (None, None), (1, 1), (32, 32)),
        ((378, 504), (448, 672), (378, 504), (448, 672)),
        ((756, 1008), (448, 672), (448, 597), (448, 672)),  # too high and too wide: height decides
        ((400, 1344), (448, 672), (200, 672), (448, 672)),  # width decides
        ((900, 100), (448, 672), (448, 50), (448, 672)),
        ((378, 504), (None, 256), (192, 256), (192, 256)),
    ],
)
def test_padding_keeps_proportions(
    image: tuple[int, int],
    frozen: tuple[int | None, int | None],
    content: tuple[int, int],
    target: tuple[int, int],
) -> None:
    assert padded(image, frozen, 32) == Fit(image, content, target)


@pytest.mark.parametrize(
    ("image", "frozen", "target"),
    [
        ((378, 504), (None, None), (384, 512)),
        ((410, 530), (None, None), (416, 544)),
        ((9, 9), (None, None), (32, 32)),
        ((378, 504), (576, 960), (576, 960)),
    ],
)
def test_stretching_goes_to_the_nearest_multiple(
    image: tuple[int, int], frozen: tuple[int | None, int | None], target: tuple[int, int]
) -> None:
    assert stretched(image, frozen, 32) == Fit(image, target, target)


@pytest.mark.parametrize("fit", [padded((41, 57), (None, None), 32), padded((7, 3), (9, 9), 1)])
def test_undoing_a_padding_is_exact(fit: Fit) -> None:
    images = torch.rand(2, 3, *fit.image)
    given = fit.apply(images)
    assert given.shape == (2, 3, *fit.target)
    assert torch.equal(fit.undo(given[:, 0]), images[:, 0])
    assert torch.equal(given[..., 0, 0], images[..., 0, 0])
    assert torch.equal(given[..., -1, -1], images[..., -1, -1])


def test_downsampling_is_antialiased() -> None:
    stripes = (torch.arange(96) % 2).float().expand(1, 3, 96, 96)
    given = stretched((96, 96), (32, 32), 1).apply(stripes)
    assert (given[..., 4:-4, 4:-4] - 0.5).abs().max() < 0.1


def test_unknown_values_do_not_affect_neighbors() -> None:
    fit = stretched((10, 40), (10, 20), 1)
    maps = torch.full((1, 10, 20), 3.0)
    maps[:, :, 12:] = torch.nan
    maps[:, 2, 2] = torch.inf
    back = fit.undo(maps)[0]
    known = torch.isfinite(back)
    assert torch.allclose(back[known], torch.tensor(3.0))
    assert not known[:, 24:].any()
    assert not known[2, 4:6].any()
    assert known.sum() == 10 * 24 - 2
    assert fit.width_factor == 2


def test_value_ranges_match_their_formulas() -> None:
    images = torch.rand(2, 3, 40, 50, generator=torch.Generator().manual_seed(0))
    mean = torch.tensor([0.485, 0.456, 0.406])[:, None, None]
    deviation = torch.tensor([0.229, 0.224, 0.225])[:, None, None]
    assert torch.equal(in_range(images, "imagenet"), (images - mean) / deviation)
    assert torch.equal(in_range(images, "-1..1"), images * 2 - 1)
    assert torch.equal(in_range(images, "0..255"), images * 255)
    assert torch.equal(in_range(images, "0..1"), images)
    assert torch.equal(in_range(images * 3 - 1, "0..1"), (images * 3 - 1).clamp(0, 1))


def test_points_are_converted_back_to_the_image() -> None:
    """100x288 is resized to 33x96 and padded to 64x96: 15 rows above, 16 below."""
    fit = padded((100, 288), (64, 96), 1)
    assert fit.content == (33, 96)
    points = torch.tensor([[0.0, 15.0], [96.0, 48.0], [48.0, 31.5], [0.0, 0.0]])
    expected = torch.tensor([[0.0, 0.0], [288.0, 100.0], [144.0, 50.0], [0.0, -15 * 100 / 33]])
    assert torch.allclose(fit.undo_points(points), expected)


def test_an_image_is_enlarged_to_fit() -> None:
    assert contained((30, 40), (80, 80)) == Fit((30, 40), (60, 80), (80, 80))
    assert contained((400, 300), (80, 80)) == Fit((400, 300), (80, 60), (80, 80))


@pytest.mark.parametrize(
    ("padding", "border"),
    [("black", (0, 0, 0)), ("white", (1, 1, 1)), ("mean", (0.485, 0.456, 0.406))],
)
def test_the_border_has_a_colour(padding: Padding, border: tuple[float, ...]) -> None:
    image = torch.rand(1, 3, 4, 4, generator=torch.Generator().manual_seed(0))
    wide = Fit((4, 4), (4, 4), (4, 8)).apply(image, padding=padding)
    assert torch.allclose(wide[..., 2:6], image)
    for column in (0, 1, 6, 7):
        assert torch.allclose(wide[0, :, :, column], torch.tensor(border)[:, None].float())


def test_intrinsics_return_to_the_image() -> None:
    fit = Fit((30, 40), (60, 80), (80, 80))
    lens = torch.tensor([[100.0, 0, 40], [0, 100, 42], [0, 0, 1]])
    expected = [50, 0, 20, 0, 50, 16, 0, 0, 1]
    assert fit.undo_intrinsics(lens).flatten().tolist() == expected
