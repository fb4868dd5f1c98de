from __future__ import annotations

import numpy as np

from stereogs_plugins.initializers.consistency_dense.confirming.geometric_filter import (
    Limits,
    consistent_depths,
)
from stereogs_plugins.initializers.consistency_dense.confirming.several_priors import most_confirmed
from stereogs_plugins.initializers.consistency_dense.projection import DepthImage
from tests.stereogs_plugins.initializers.depth_scenes import camera_at

CAMERAS = [camera_at(x) for x in (0.0, 0.2, 0.4)]
LIMITS = Limits(reprojection=0.1, depth=0.01, views=1, bounds=(1.0, 10.0))


def plane(depth: float) -> DepthImage:
    return np.full((40, 60), depth, dtype=np.float32)


def test_a_later_prior_fills_what_the_first_leaves_open() -> None:
    upper, lower = plane(5.0), plane(5.0)
    upper[20:] = lower[:20] = 0
    first, _, _ = most_confirmed(CAMERAS, [[upper] * 3, [lower] * 3], LIMITS)
    seen = (slice(None), slice(10, 60))  # another view looks there too
    np.testing.assert_allclose(first.confirmed[seen], 5.0, rtol=1e-6)
    assert (first.answer[seen] == 5).all()
    assert (first.prior[:19, 10:] == 0).all()
    assert (first.prior[21:, 10:] == 1).all()


def test_the_depth_that_more_views_confirm_counts_whichever_prior_it_is_from() -> None:
    # One prior is wrong in the last view, so that only two views agree; the other has all three agree.
    worse, better = [plane(4.0), plane(4.0), plane(8.0)], [plane(5.0)] * 3
    for answers, right in (([worse, better], 1), ([better, worse], 0)):
        found = most_confirmed(CAMERAS, answers, LIMITS)[0]
        assert (found.prior[:, 25:] == right).all()
        np.testing.assert_allclose(found.confirmed[:, 25:], 5.0, rtol=1e-6)


def test_of_equals_the_first_counts() -> None:
    for nearer, farther in ((4.0, 5.0), (5.0, 4.0)):
        found = most_confirmed(CAMERAS, [[plane(nearer)] * 3, [plane(farther)] * 3], LIMITS)[1]
        inner = found.confirmed[:, 15:45]
        np.testing.assert_allclose(inner, nearer, rtol=1e-6)


def test_what_no_view_confirms_stays_open_and_shows_the_first_answer() -> None:
    answers = [[plane(z) for z in (3.0, 4.0, 5.0)], [plane(z) for z in (6.0, 7.0, 8.0)]]
    for found, shown in zip(most_confirmed(CAMERAS, answers, LIMITS), (3, 4, 5), strict=True):
        assert not found.confirmed.any()
        assert (found.answer == shown).all()


def test_one_prior_is_filtered_as_ever() -> None:
    generator = np.random.default_rng(0)
    depths = [plane(5.0) * generator.normal(1, 0.004, (40, 60)).astype(np.float32) for _ in CAMERAS]
    alone = consistent_depths(CAMERAS, depths, LIMITS)
    for found, expected, depth in zip(
        most_confirmed(CAMERAS, [depths], LIMITS), alone, depths, strict=True
    ):
        assert 0 < (expected > 0).mean() < 1
        assert np.array_equal(found.confirmed, expected)
        assert np.array_equal(found.answer, depth)
