from __future__ import annotations

import numpy as np

from stereogs_plugins.initializers.consistency_dense.completion.planes import plane_depths
from stereogs_plugins.initializers.consistency_dense.projection import pixel_centers
from tests.stereogs_plugins.initializers.depth_scenes import camera_at

GREY = np.full((40, 60, 3), 0.5, dtype=np.float32)
COLUMNS, ROWS = pixel_centers(camera_at(0.0))


def test_a_slanted_wall_continues_beyond_its_known_part() -> None:
    truth = (1 / (0.2 + 0.004 * COLUMNS + 0.002 * ROWS)).astype(np.float32)
    depth = np.where(COLUMNS < 25, truth, 0).astype(np.float32)
    depth[::3, :10] *= 1.3  # a tenth of the known depths is wrong
    guessed = plane_depths(GREY, depth)
    near = (depth == 0) & (1 / truth < 2 / truth[depth > 0].min())
    assert not guessed[depth > 0].any()
    np.testing.assert_allclose(
        guessed[near & (COLUMNS < 35)], truth[near & (COLUMNS < 35)], rtol=1e-3
    )


def test_each_segment_has_its_own_plane() -> None:
    image = np.full((120, 60, 3), 0.5, dtype=np.float32)
    image[:, 30:] = (0.1, 0.8, 0.1)
    truth = np.full((120, 60), 2.0, dtype=np.float32)
    truth[:, 30:] = 6.0
    hole = np.zeros((120, 60), dtype=np.bool_)
    hole[50:70, 20:42] = True
    guessed = plane_depths(image, np.where(hole, 0, truth).astype(np.float32))
    hole[:, 27:33] = False  # blurred edge: segments of one column determine no plane
    np.testing.assert_allclose(guessed, np.where(hole, truth, 0), rtol=1e-5)


def test_no_plane_where_known_depths_lie_on_none() -> None:
    generator = np.random.default_rng(0)
    depth = generator.uniform(1, 8, (40, 60)).astype(np.float32)
    depth[10:20] = 0
    assert not plane_depths(GREY, depth).any()


def test_too_few_or_collinear_depths_determine_no_plane() -> None:
    depth = np.zeros((40, 60), dtype=np.float32)
    depth[5, :20] = 3.0
    assert not plane_depths(GREY, depth).any()
    depth[5] = 3.0
    assert not plane_depths(GREY, depth).any()


def test_the_same_answer_twice() -> None:
    generator = np.random.default_rng(1)
    image = generator.random((40, 60, 3)).astype(np.float32)
    depth = (3 + 0.1 * generator.random((40, 60))).astype(np.float32)
    depth[generator.random((40, 60)) < 0.5] = 0
    assert (plane_depths(image, depth) == plane_depths(image, depth)).all()
