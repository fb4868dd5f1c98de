"""Pixels moved forwards as points, and looked up backwards."""

from __future__ import annotations

import torch

from stereogs_plugins.regularizers.unseen_views.cycle_filtered_warping import look_up
from stereogs_plugins.regularizers.unseen_views.forward_warping import forward_splat
from tests.stereogs_plugins.initializers.depth_scenes import camera_at

COLORS = torch.rand(40, 60, 3, generator=torch.Generator().manual_seed(0))
EVERYWHERE = torch.ones(40, 60, dtype=torch.bool)


def test_a_camera_that_stays_sees_the_image_again() -> None:
    camera, depth = camera_at(0), torch.full((40, 60), 5.0)
    picture, hit = forward_splat(camera, COLORS, depth, EVERYWHERE, camera)
    assert hit.all()
    torch.testing.assert_close(picture, COLORS, atol=1e-5, rtol=0)


def test_a_wall_moves_by_its_disparity_and_leaves_a_hole() -> None:
    # Disparity f d / z = 50 * 0.4 / 5 = 4 pixels.
    depth = torch.full((40, 60), 5.0)
    picture, hit = forward_splat(camera_at(0), COLORS, depth, EVERYWHERE, camera_at(0.4))
    torch.testing.assert_close(picture[:, :56], COLORS[:, 4:], atol=1e-4, rtol=0)
    assert hit[:, :56].all()
    assert not hit[:, 57:].any()
    assert (picture[:, 57:] == 0).all()


def test_half_a_pixel_blends_two() -> None:
    depth = torch.full((40, 60), 50.0)  # half a pixel for a camera at 0.5
    picture, _ = forward_splat(camera_at(0), COLORS, depth, EVERYWHERE, camera_at(0.5))
    wanted = (COLORS[:, :-1] + COLORS[:, 1:]) / 2
    torch.testing.assert_close(picture[:, :59], wanted, atol=1e-4, rtol=0)


def test_the_nearer_of_two_points_hides_the_other_and_unknown_pixels_stay_away() -> None:
    depth = torch.full((40, 60), 10.0)
    depth[:, 20:30] = 5.0  # moves 4 pixels, its background 2
    known = EVERYWHERE.clone()
    known[:, 50:] = False
    picture, hit = forward_splat(camera_at(0), COLORS, depth, known, camera_at(0.4))
    torch.testing.assert_close(picture[:, 16:26], COLORS[:, 20:30], atol=1e-4, rtol=0)
    torch.testing.assert_close(picture[:, :15], COLORS[:, 2:17], atol=1e-4, rtol=0)
    assert not hit[:, 26:28].any()  # what the foreground had hidden
    assert not hit[:, 49:].any()


def test_what_is_behind_the_other_camera_is_not_seen() -> None:
    turned = torch.diag(torch.tensor([-1.0, 1, -1, 1], dtype=torch.float64))
    behind = type(camera_at(0))(turned, 50, 50, 30, 20, 60, 40)
    _, hit = forward_splat(camera_at(0), COLORS, torch.full((40, 60), 5.0), EVERYWHERE, behind)
    assert not hit.any()


def test_looking_up_at_centres_gives_the_pixels_and_between_them_their_mean() -> None:
    u, v = camera_at(0).pixel_centers()
    values, inside = look_up(COLORS.double(), u, v)
    torch.testing.assert_close(values, COLORS.double())
    assert inside.all()
    between, _ = look_up(COLORS.double(), u[:, :-1] + 0.5, v[:, :-1])
    torch.testing.assert_close(between, (COLORS[:, :-1] + COLORS[:, 1:]).double() / 2)
    _, outside = look_up(COLORS, u + 100, v)
    assert not outside.any()


def test_looking_up_has_the_gradient_of_finite_differences() -> None:
    image = COLORS[:6, :7].double().requires_grad_()
    generator = torch.Generator().manual_seed(1)
    u = (1 + 5 * torch.rand(9, generator=generator, dtype=torch.float64)).requires_grad_()
    v = (1 + 4 * torch.rand(9, generator=generator, dtype=torch.float64)).requires_grad_()
    assert torch.autograd.gradcheck(lambda *x: look_up(*x)[0], (image, u, v))
