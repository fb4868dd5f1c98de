from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from registry import Scene
from stereogs_plugins.initializers.consistency_dense.geometric_consistency import (
    Limits,
    consistent_depths,
    default_min_consistent,
    most_confirmed,
    without_small_patches,
)
from stereogs_plugins.initializers.consistency_dense.projection import (
    DepthImage,
    Mask,
    lift,
    look_up,
    pixel_centers,
    project,
)
from tests.stereogs_plugins.initializers.depth_scenes import camera_at, true_depth

BOUNDS = (1.0, 10.0)


@pytest.fixture(scope="module")
def scene(procedural_room: Scene) -> Scene:
    return replace(procedural_room, test=(), points=None)


def confirmed(
    scene: Scene, depths: list[DepthImage], *, pixels: float = 1.0, relative: float = 0.01
) -> list[DepthImage]:
    return consistent_depths(
        [view.camera for view in scene.train],
        depths,
        Limits(pixels, relative, 1, BOUNDS),
    )


def co_visible(scene: Scene, depths: list[DepthImage], index: int) -> Mask:
    """Pixels whose surface another view's true depth shows too."""
    camera = scene.train[index].camera
    points = lift(camera, *pixel_centers(camera), depths[index])
    result = np.zeros(depths[index].shape, dtype=np.bool_)
    for other, view in enumerate(scene.train):
        if other != index:
            u, v, z = project(view.camera, points)
            result |= np.abs(look_up(depths[other], u, v) - z) < 0.005 * z
    return result


def test_true_depth_is_confirmed_and_outliers_are_not(scene: Scene) -> None:
    truth = [true_depth(view).numpy() for view in scene.train]
    generator = np.random.default_rng(0)
    outlier = [generator.random(depth.shape) < 0.05 for depth in truth]
    spoilt = [
        np.where(o, d * generator.choice([0.7, 1.4], d.shape), d).astype(np.float32)
        for d, o in zip(truth, outlier, strict=True)
    ]
    for index, found in enumerate(confirmed(scene, truth)):
        both = co_visible(scene, truth, index)
        assert both.mean() > 0.5
        assert (found > 0)[both].mean() > 0.97
        np.testing.assert_allclose(found[found > 0], truth[index][found > 0], rtol=0.011)
    # Each outlier of another view also costs the few true pixels that would have been compared with it.
    for index, found in enumerate(confirmed(scene, spoilt)):
        both = co_visible(scene, truth, index) & ~outlier[index]
        assert (found > 0)[both].mean() > 0.9
        assert (found > 0)[outlier[index]].mean() < 0.01


def test_noise_is_averaged(scene: Scene) -> None:
    truth = [true_depth(view).numpy() for view in scene.train]
    generator = np.random.default_rng(1)
    noisy = [(d * generator.normal(1, 0.003, d.shape)).astype(np.float32) for d in truth]
    for index, found in enumerate(confirmed(scene, noisy, pixels=2.0, relative=0.05)):
        seen = (found > 0) & co_visible(scene, truth, index)
        before = np.abs(noisy[index] / truth[index] - 1)[seen].mean()
        after = np.abs(found / truth[index] - 1)[seen].mean()
        assert after < 0.8 * before


def test_a_frontal_plane_is_exact_with_off_center_principal_points() -> None:
    cameras = [camera_at(0.0, cx=22.0, cy=25.5), camera_at(0.4, cx=41.0, cy=14.0)]
    depths = [np.full((40, 60), 5.0, dtype=np.float32)] * 2
    first, second = consistent_depths(
        cameras,
        depths,
        Limits(1e-6, 1e-6, 1, BOUNDS),
    )
    # A point moves by f * baseline / depth = 4 pixels, and with the principal point by 19 and -11.5.
    u, v = pixel_centers(cameras[0])
    expected = (u - 4 + 19 < 60) & (u - 4 + 19 >= 0) & (v - 11.5 >= 0) & (v - 11.5 < 40)
    assert np.array_equal(first > 0, expected)
    assert (first[expected] == 5).all()
    assert np.array_equal(second > 0, (u + 4 - 19 >= 0) & (u + 4 - 19 < 60) & (v + 11.5 < 40))


def test_both_limits_separate_different_depths() -> None:
    cameras = [camera_at(0.0), camera_at(0.5)]
    depths = [np.full((40, 60), z, dtype=np.float32) for z in (5.0, 5.1)]

    def share(pixels: float, relative: float) -> float:
        found, _ = consistent_depths(
            cameras,
            depths,
            Limits(pixels, relative, 1, BOUNDS),
        )
        return float((found > 0).mean())

    # The second depth is 2 % farther, which moves the pixel by 25 / 5 - 25 / 5.1 = 0.098.
    assert share(0.11, 0.021) > 0.8
    assert share(0.09, 0.021) == 0
    assert share(0.11, 0.019) == 0


def test_the_reprojection_error_is_a_distance() -> None:
    """As above, but the second camera moves along both axes: 0.098 pixels in each."""
    cameras = [camera_at(0.0), camera_at(0.5, 0.5)]
    depths = [np.full((40, 60), z, dtype=np.float32) for z in (5.0, 5.1)]
    for pixels, share in ((0.137, 0.0), (0.141, 0.5)):
        found, _ = consistent_depths(cameras, depths, Limits(pixels, 0.021, 1, BOUNDS))
        assert share <= (found > 0).mean() <= 2 * share


def test_fused_depth_is_the_mean() -> None:
    depths = [np.full((40, 60), z, dtype=np.float32) for z in (5.0, 5.1)]
    found, _ = consistent_depths(
        [camera_at(0.0), camera_at(0.5)],
        depths,
        Limits(1.0, 0.05, 1, BOUNDS),
    )
    np.testing.assert_allclose(found[found > 0], 5.05, rtol=1e-6)


@pytest.mark.parametrize(("needed", "kept"), [(1, True), (2, False)])
def test_min_consistent_views_must_agree(needed: int, kept: bool) -> None:
    depths = [np.full((40, 60), z, dtype=np.float32) for z in (5.0, 5.0, 0.0)]
    found = consistent_depths(
        [camera_at(x) for x in (0.0, 0.2, 0.4)],
        depths,
        Limits(1.0, 0.01, needed, BOUNDS),
    )
    assert (found[0] > 0).any() == kept
    assert not found[2].any()


def test_default_number_of_views_that_must_agree() -> None:
    assert [default_min_consistent(n) for n in (2, 3, 4, 5, 6, 7, 12)] == [1, 1, 2, 2, 3, 3, 3]


def test_small_patches_are_removed() -> None:
    depth = np.zeros((20, 20), dtype=np.float32)
    depth[1:4, 1:4] = 2.0
    depth[8:18, 2:12] = 2.0
    depth[8:18, 12:15] = 3.0  # touches the large patch, but a step in depth separates them
    found = without_small_patches(depth, min_pixels=40, max_step=0.05)
    expected = np.zeros_like(depth)
    expected[8:18, 2:12] = 2.0
    assert np.array_equal(found, expected)
    assert np.array_equal(without_small_patches(depth, min_pixels=9, max_step=0.05), depth)


def test_steps_are_relative_to_the_nearer_pixel() -> None:
    depth = np.full((10, 6), 2.0, dtype=np.float32)
    depth[:, 3:] = 2.1
    for max_step, kept in ((0.049, False), (0.051, True)):
        found = without_small_patches(depth, min_pixels=40, max_step=max_step)
        assert (found > 0).all() == kept


ROW_OF_CAMERAS = [camera_at(x) for x in (0.0, 0.2, 0.4)]
TIGHT = Limits(0.1, 0.01, 1, BOUNDS)


def plane(depth: float) -> DepthImage:
    return np.full((40, 60), depth, dtype=np.float32)


def test_a_later_prior_fills_holes_of_the_first() -> None:
    upper, lower = plane(5.0), plane(5.0)
    upper[20:] = lower[:20] = 0
    first, _, _ = most_confirmed(ROW_OF_CAMERAS, [[upper] * 3, [lower] * 3], TIGHT)
    seen = (slice(None), slice(10, 60))  # another view looks there too
    np.testing.assert_allclose(first.confirmed[seen], 5.0, rtol=1e-6)
    assert (first.depth[seen] == 5).all()
    assert (first.prior[:19, 10:] == 0).all()
    assert (first.prior[21:, 10:] == 1).all()


def test_the_depth_that_more_views_confirm_wins_in_either_order() -> None:
    # One prior is wrong in the last view, so that only two views agree; the other has all three agree.
    worse, better = [plane(4.0), plane(4.0), plane(8.0)], [plane(5.0)] * 3
    for answers, right in (([worse, better], 1), ([better, worse], 0)):
        found = most_confirmed(ROW_OF_CAMERAS, answers, TIGHT)[0]
        assert (found.prior[:, 25:] == right).all()
        np.testing.assert_allclose(found.confirmed[:, 25:], 5.0, rtol=1e-6)


def test_the_first_prior_wins_ties() -> None:
    for nearer, farther in ((4.0, 5.0), (5.0, 4.0)):
        found = most_confirmed(ROW_OF_CAMERAS, [[plane(nearer)] * 3, [plane(farther)] * 3], TIGHT)[
            1
        ]
        inner = found.confirmed[:, 15:45]
        np.testing.assert_allclose(inner, nearer, rtol=1e-6)


def test_unconfirmed_pixels_keep_the_depth_of_the_first_prior() -> None:
    answers = [[plane(z) for z in (3.0, 4.0, 5.0)], [plane(z) for z in (6.0, 7.0, 8.0)]]
    for found, shown in zip(most_confirmed(ROW_OF_CAMERAS, answers, TIGHT), (3, 4, 5), strict=True):
        assert not found.confirmed.any()
        assert (found.depth == shown).all()


def test_one_prior_gives_the_plain_filter() -> None:
    generator = np.random.default_rng(0)
    depths = [
        plane(5.0) * generator.normal(1, 0.004, (40, 60)).astype(np.float32) for _ in ROW_OF_CAMERAS
    ]
    alone = consistent_depths(ROW_OF_CAMERAS, depths, TIGHT)
    for found, expected, depth in zip(
        most_confirmed(ROW_OF_CAMERAS, [depths], TIGHT), alone, depths, strict=True
    ):
        assert 0 < (expected > 0).mean() < 1
        assert np.array_equal(found.confirmed, expected)
        assert np.array_equal(found.depth, depth)
