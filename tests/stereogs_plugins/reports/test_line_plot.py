from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree

import pytest

from stereogs_plugins.reports._line_plot import line_plot


def ticks(figure: str) -> list[str]:
    return re.findall(r'text-anchor="end">([^<]+)</text>', figure)[:-1]  # the last is an iteration


def test_lines_go_from_the_first_to_the_last_point() -> None:
    figure = line_plot("Loss", {"loss": [(0, 1.0), (50, 0.5), (100, 0.0)]})
    (path,) = re.findall(r'points="([^"]+)"', figure)
    points = [tuple(map(float, point.split(","))) for point in path.split()]
    assert [x for x, _ in points] == [58.0, 223.0, 388.0]
    ups = [y for _, y in points]
    assert ups[0] < ups[1] < ups[2]  # larger values are higher up, at smaller y
    assert ups[1] == pytest.approx((ups[0] + ups[2]) / 2, abs=0.1)
    assert ups[2] == 194.0  # zero, on the lower edge: no loss is below it


def test_rules_lie_at_round_numbers() -> None:
    assert ticks(line_plot("x", {"x": [(1, 0.0), (9, 1.0)]})) == ["0", "0.5", "1"]
    assert ticks(line_plot("x", {"x": [(1, 150_000.0), (9, 185_321.0)]})) == [
        "150,000",
        "160,000",
        "170,000",
        "180,000",
    ]


def test_values_of_several_decades_are_drawn_on_a_logarithmic_axis() -> None:
    figure = line_plot("x", {"x": [(1, 1e-6), (9, 1e-2)]})
    assert "x (logarithmic)" in figure
    assert ticks(figure) == ["1e-06", "1e-05", "0.0001", "0.001", "0.01"]
    assert "logarithmic" not in line_plot("x", {"x": [(1, 0.0), (9, 1e9)]})


@pytest.mark.parametrize("value", [0.0, 3.0, -2.0, 1e-9, 1e12])
def test_a_constant_and_a_single_point_are_drawn(value: float) -> None:
    for points in ([(10, value), (20, value)], [(10, value)]):
        figure = line_plot("x", {"x": points})
        assert "nan" not in figure
        ElementTree.fromstring(figure)
    assert "<circle" in figure


def test_nothing_to_draw_is_no_figure() -> None:
    assert line_plot("x", {}) == line_plot("x", {"a": []}) == ""


def test_labels_are_escaped_and_listed_when_there_are_two() -> None:
    figure = line_plot("<b>", {"a<b": [(1, 1.0)], "c&d": [(1, 2.0)]})
    assert "&lt;b&gt;" in figure
    assert "a&lt;b" in figure
    assert "c&amp;d" in figure
    ElementTree.fromstring(figure)
    assert "<ul>" not in line_plot("x", {"a": [(1, 1.0)]})
