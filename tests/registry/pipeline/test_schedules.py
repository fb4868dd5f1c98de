from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from registry.pipeline.parts import derived_seed
from registry.pipeline.schedule import Schedule, active_sh_degree
from tests.host import ViewOrder


def due(schedule: Schedule, last: int) -> list[int]:
    return [iteration for iteration in range(1, last + 1) if schedule.due(iteration)]


def test_due_from_start_to_stop_in_multiples() -> None:
    assert due(Schedule(), 3) == [1, 2, 3]
    assert due(Schedule(start=500, stop=800, every=100), 2000) == [500, 600, 700, 800]
    assert due(Schedule(start=550, stop=799, every=100, phase=0), 2000) == [600, 700]
    assert due(Schedule(every=3000), 7000) == [3000, 6000]
    assert due(Schedule(start=3), 5) == [3, 4, 5]


def test_a_given_start_is_the_first_iteration_that_is_due() -> None:
    assert due(Schedule(start=5, every=2), 10) == [5, 7, 9]
    assert due(Schedule(start=550, stop=799, every=100), 2000) == [550, 650, 750]
    assert due(Schedule(start=1, every=3), 8) == [1, 4, 7]
    assert Schedule(start=500, every=100).phase == 0
    written = Schedule(start=5, every=2).model_dump_json()
    assert Schedule.model_validate_json(written, strict=True) == Schedule(start=5, every=2)


def test_over_means_never_again() -> None:
    schedule = Schedule(stop=10, every=4)
    assert not schedule.over(10)
    assert schedule.over(11)
    assert not Schedule().over(10**9)


@pytest.mark.parametrize(
    ("schedule", "iterations", "due"),
    [
        (Schedule(start=5000), 10, False),
        (Schedule(start=10), 10, True),
        (Schedule(every=11), 10, False),
        (Schedule(start=3, stop=4, every=5, phase=0), 10, False),
        (Schedule(start=3, stop=5, every=5), 10, True),
        (Schedule(every=100, phase=7), 10, True),
        (Schedule(start=8, every=100, phase=7), 106, False),
        (Schedule(start=8, every=100, phase=7), 107, True),
    ],
)
def test_the_iterations_that_are_due(schedule: Schedule, iterations: int, due: bool) -> None:
    found = schedule.due_in(iterations)
    assert bool(found) is due
    assert list(found) == [i for i in range(1, iterations + 1) if schedule.due(i)]


def test_bands_come_one_by_one() -> None:
    steps = {1: 0, 999: 0, 1000: 1, 2999: 2, 3000: 3, 30_000: 3}
    assert {i: active_sh_degree(i, 3, 1000) for i in steps} == steps
    assert active_sh_degree(30_000, 1, 1000) == 1


def test_seeds_are_the_same_on_every_machine() -> None:
    assert derived_seed(0, "views") == 4875131893980719605
    assert derived_seed(1, "views") != derived_seed(0, "views")
    assert derived_seed(0, "regularizers.a") != derived_seed(0, "regularizers.b")


@given(st.integers(0, 2**64), st.text(st.sampled_from("abc._é"), max_size=8))
def test_seeds_fit_torch(seed: int, name: str) -> None:
    assert 0 <= derived_seed(seed, name) < 2**63


def test_view_order_goes_on_after_a_restore() -> None:
    order = ViewOrder(5, seed=3)
    for _ in range(7):
        order.next()
    state = order.state()
    expected = [order.next() for _ in range(11)]
    other = ViewOrder(5, seed=99)
    other.restore(state)
    assert [other.next() for _ in range(11)] == expected
