from __future__ import annotations

from stereogs_plugins.tools.view.pace import Pace


def test_sizes_keep_the_shape_and_fit_the_time() -> None:
    pace = Pace()
    for _ in range(20):
        pace.took(100_000, 1.0)
    width, height = pace.size(1600, 800, 1.0)
    assert abs(width - 2 * height) <= 2
    assert 90_000 < width * height < 110_000


def test_a_fast_machine_draws_the_window_and_no_more() -> None:
    pace = Pace()
    for _ in range(20):
        pace.took(1_000_000, 0.001)
    assert pace.size(640, 480, 0.1) == (640, 480)


def test_a_slow_machine_still_shows_something() -> None:
    pace = Pace()
    for _ in range(40):
        pace.took(100, 10.0)
    width, height = pace.size(1600, 1200, 0.08)
    assert width * height > 19_000
