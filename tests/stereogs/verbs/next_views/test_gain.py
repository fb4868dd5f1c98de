"""The expected gain, of a wall 10 in front of cameras at z = 0: the depth that each sees is known exactly."""

from __future__ import annotations

import pytest
import torch

from core_rasterizer import Camera, Rendering
from stereogs.verbs.next_views.gain import ExpectedGain

WALL = 10.0


def at(x: float) -> Camera:
    """A camera that looks straight at the wall."""
    return Camera.look_at((x, 0.0, 0.0), (x, 0.0, WALL), 60.0, 80, 60)


def wall(camera: Camera) -> Rendering:
    """What a camera sees."""
    alpha = torch.ones(camera.height, camera.width)
    return Rendering(torch.zeros(*alpha.shape, 3), WALL * alpha, alpha)


def gains(training: list[Camera], candidates: list[Camera]) -> list[float]:
    return [float(one) for one in ExpectedGain(wall, training, candidates).gains()]


def test_a_photograph_that_exists_gains_least() -> None:
    again, aside = gains([at(0.0)], [at(0.0), at(2.0)])
    assert 0 < again < aside


def test_the_middle_of_a_gap_gains_more_than_its_edge() -> None:
    near, middle, other = gains([at(-4.0), at(4.0)], [at(-3.0), at(0.0), at(3.0)])
    assert near == pytest.approx(other)
    assert middle > near


def test_a_photograph_that_no_other_overlaps_gains_nothing() -> None:
    gain = ExpectedGain(wall, [at(0.0)], [at(4.0), at(40.0)])
    overlapping, alone = gain.gains()
    assert overlapping > 0
    assert alone == 0
    assert gain.overlap[1] == 0


def test_after_one_is_taken_its_neighbour_gains_less_and_the_others_as_much() -> None:
    gain = ExpectedGain(wall, [at(0.0)], [at(4.0), at(4.5), at(-4.0)])
    before, unknown = gain.gains(), gain.unknown
    gain.take(0)
    after = gain.gains()
    assert gain.unknown < unknown
    assert after[1] < 0.6 * before[1]
    assert after[2] > 0.9 * before[2]
