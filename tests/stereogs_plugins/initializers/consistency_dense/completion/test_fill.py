from __future__ import annotations

import numpy as np
import pytest

from stereogs_plugins.initializers.consistency_dense.completion.fill import (
    fill_holes,
    nearest_known,
)
from stereogs_plugins.initializers.consistency_dense.projection import pixel_centers
from tests.stereogs_plugins.initializers.depth_scenes import camera_at

GREY = np.full((40, 60, 3), 0.5, dtype=np.float32)


def test_a_plane_continues_across_a_hole() -> None:
    u, _ = pixel_centers(camera_at(0.0))
    truth = (1 / (0.2 + 0.001 * u)).astype(np.float32)
    depth = truth.copy()
    depth[15:25, 20:32] = 0
    filled = fill_holes(GREY, depth)
    hole = depth == 0
    assert not filled[~hole].any()
    np.testing.assert_allclose(filled[hole], truth[hole], rtol=0.05)


@pytest.mark.parametrize("seen_through", [2.0, 6.0])
def test_a_hole_joins_the_surface_of_its_color(seen_through: float) -> None:
    image, depth = GREY.copy(), np.full((40, 60), 2.0, dtype=np.float32)
    image[:, 30:] = (0.1, 0.8, 0.1)
    depth[:, 30:] = 6.0
    depth[10:30, 25:35] = 0
    filled = fill_holes(image, depth)
    side = np.s_[12:28, 25:28] if seen_through == 2.0 else np.s_[12:28, 32:35]
    np.testing.assert_allclose(filled[side], seen_through)


def test_a_hole_without_matching_color_is_background() -> None:
    depth = np.full((40, 60), 2.0, dtype=np.float32)
    depth[:, 40:] = 6.0
    depth[10:30, 33:43] = 0
    assert fill_holes(GREY, depth)[20, 38] == 6.0


def test_holes_without_known_depths_stay_empty() -> None:
    assert not fill_holes(GREY, np.zeros((40, 60), dtype=np.float32)).any()
    depth = np.zeros((40, 60), dtype=np.float32)
    depth[20, 30] = 4.0
    filled = fill_holes(GREY, depth)
    assert set(np.unique(filled)) == {0.0, 4.0}
    assert filled[20, 5] == 4.0  # the same row
    assert filled[3, 58] == 0.0  # in none of the eight directions


def test_nearest_known_in_eight_directions() -> None:
    generator = np.random.default_rng(0)
    known = generator.random((9, 13)) < 0.2
    answers = nearest_known(known)
    found = []
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            if not (down or right):
                continue
            answer = np.full(known.shape, -1)
            for row in range(9):
                for column in range(13):
                    r, c = row, column
                    while 0 <= r < 9 and 0 <= c < 13:
                        if known[r, c]:
                            answer[row, column] = r * 13 + c
                            break
                        r, c = r + down, c + right
            found.append(answer)
    for expected in found:
        assert sum(np.array_equal(expected, answer) for answer in answers) == 1
