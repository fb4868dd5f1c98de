"""Places in words: three photographs in a row, a step of 1 apart, 10 in front of what they show."""

from __future__ import annotations

import pytest

from core_rasterizer import Camera
from stereogs.verbs.next_views.where_to_stand import Photographs

SUBJECT = (0.0, 0.0, 10.0)


def at(x: float, y: float = 0.0, z: float = 0.0, target: tuple[float, ...] = SUBJECT) -> Camera:
    return Camera.look_at((x, y, z), target, 60.0, 80, 60)


ROW = Photographs(("A", "B", "C"), (at(-1), at(0), at(1)), (10.0, 10.0, 10.0))


@pytest.mark.parametrize(
    ("camera", "place"),
    [
        (at(0.5), "between B and C"),
        (at(-0.7), "between A and B, nearer to A"),
        (at(-0.5, -0.5), "between A and B, half a step higher"),
        (at(2.0), "one step to the right of C"),
        (at(-2.3, 0.6), "1.5 steps to the left of A, half a step lower"),
        (at(0.0, 0.0, 2.0), "where B was taken, 2 steps closer"),
        (at(0.0, 0.0, -1.5), "where B was taken, 1.5 steps farther away"),
        (at(10.0, 0.0, 10.0), "14.5 steps (84° around the subject) to the right of C"),
    ],
)
def test_a_place_is_told_from_the_nearest_photographs(camera: Camera, place: str) -> None:
    assert ROW.words(camera, 10.0).split(";")[0] == place


@pytest.mark.parametrize(
    ("target", "aim"),
    [
        (SUBJECT, "what is in the middle of C"),
        ((-4.0, 0.0, 10.0), "what is in the left part of C"),
        ((4.0, -3.0, 10.0), "what is in the upper right part of C"),
        ((0.0, 0.0, -10.0), "what no photograph shows yet"),
    ],
)
def test_the_aim_is_told_by_what_is_there_in_a_photograph(
    target: tuple[float, float, float], aim: str
) -> None:
    camera = at(2.0, target=target)
    distance = sum((a - b) ** 2 for a, b in zip(target, (2.0, 0.0, 0.0), strict=True)) ** 0.5
    assert ROW.words(camera, distance).endswith(f"; aim at {aim}")


def test_a_step_is_the_distance_of_neighbours_within_limits() -> None:
    assert ROW.step == pytest.approx(1.0)
    near = Photographs(("A", "B"), (at(0.0), at(0.01)), (10.0, 10.0))
    assert near.step == pytest.approx(0.7, abs=0.01), "4 degrees"
    alone = Photographs(("A",), (at(0.0),), (10.0,))
    assert alone.step == pytest.approx(3.64, abs=0.01), "20 degrees"
    assert ROW.step_words == "A step is 10% of the distance to the subject."
