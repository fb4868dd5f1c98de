from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree

import pytest

from registry.toolkit.web_page import Axis, Line, Point, line_plot


def plot(*lines: Line, axis: Axis | None = None) -> str:
    """A plot with ticks at the first and last point, unless an axis is given."""
    places = [point.across for line in lines for point in line.points] or [0.0]
    ends = Axis([(min(places), "first"), (max(places), "last")])
    figure = line_plot("x", lines, axis or ends)
    if figure:
        ElementTree.fromstring(figure)
    return figure


def line(*values: float, label: str = "") -> Line:
    """A line with one point per value."""
    return Line(label, [Point(index, value) for index, value in enumerate(values)])


def paths(figure: str) -> list[list[tuple[float, float]]]:
    """Vertices of each line in the image; y points down."""
    return [
        [(float(x), float(y)) for x, y in (corner.split(",") for corner in path.split())]
        for path in re.findall(r'points="([^"]+)"', figure)
    ]


def numbers(figure: str) -> list[str]:
    """Texts next to the plot."""
    return re.findall(r'text-anchor="end">([^<]+)</text>', figure)


def texts_below(figure: str) -> dict[str, float]:
    """Horizontal centers of the texts below the plot."""
    found = re.findall(r'<text x="([^"]+)" y="[^"]+" text-anchor="middle">([^<]+)<', figure)
    return {text: float(x) for x, text in found}


def test_lines_go_from_the_first_to_the_last_point() -> None:
    ((left, middle, right),) = paths(plot(line(1.0, 0.5, 0.0)))
    assert middle == pytest.approx(((left[0] + right[0]) / 2, (left[1] + right[1]) / 2), abs=0.1)
    assert left[0] < right[0]
    assert left[1] < right[1]
    assert right[1] == 194.0, "zero is the lower edge: no value is below it"


def test_values_are_above_their_position_on_the_axis() -> None:
    axis = Axis([(0, "none"), (0.5, "half"), (2, "<two>")], "factor & more")
    figure = plot(Line("", [Point(0.5, 1), Point(2, 3)]), axis=axis)
    below = texts_below(figure)
    assert list(below) == ["none", "half", "&lt;two&gt;", "factor &amp; more"]
    assert [x for x, _ in paths(figure)[0]] == [below["half"], below["&lt;two&gt;"]]
    quarter = (below["half"] - below["none"]) / (below["&lt;two&gt;"] - below["none"])
    assert quarter == pytest.approx(0.25, abs=0.01)


def test_grid_lines_are_at_round_numbers() -> None:
    assert numbers(plot(line(0.0, 1.0))) == ["0", "0.5", "1"]
    assert numbers(plot(line(150_000.0, 185_321.0))) == ["150,000", "160,000", "170,000", "180,000"]


def test_values_of_several_decades_are_drawn_on_a_logarithmic_axis() -> None:
    figure = plot(line(1e-6, 1e-2))
    assert "x (logarithmic)" in figure
    assert numbers(figure) == ["1e-06", "1e-05", "0.0001", "0.001", "0.01"]
    assert "logarithmic" not in plot(line(0.0, 1e9))


def test_a_spread_is_an_error_bar_within_the_plot() -> None:
    figure = plot(Line("", [Point(0, 10.0, spread=4.0), Point(1, 12.0)]))
    ((x, y), _) = paths(figure)[0]
    (bar,) = re.findall(r'<line x1="(\S+)" x2="(\S+)" y1="(\S+)" y2="(\S+)" stroke', figure)
    left, right, top, bottom = map(float, bar)
    assert left == right == x
    assert (top + bottom) / 2 == pytest.approx(y, abs=0.1)
    assert 10 < top < bottom < 194


def test_a_spread_that_reaches_zero_prevents_a_logarithmic_axis() -> None:
    points = [Point(0, 1.0, spread=1.0), Point(1, 1e6)]
    assert "logarithmic" not in plot(Line("", points))
    assert "logarithmic" in plot(Line("", [Point(0, 1.0), Point(1, 1e6)]))


def test_few_points_are_drawn_with_their_value() -> None:
    figure = plot(line(20.0, 21.5))
    assert re.findall(r"<circle .*?><title>(.*?)</title>", figure) == ["20", "21.5"]
    assert "<circle" not in plot(line(*range(100)))


@pytest.mark.parametrize("value", [0.0, 3.0, -2.0, 1e-9, 1e12])
def test_a_constant_and_a_single_point_are_drawn(value: float) -> None:
    for values in ([value, value], [value]):
        figure = plot(line(*values))
        assert "nan" not in figure
        assert figure.count("<circle") == len(values)


def test_a_plot_without_points_is_empty() -> None:
    assert plot() == plot(line(label="a")) == ""


def test_labels_are_escaped_and_listed_when_there_are_two() -> None:
    figure = plot(line(1.0, label="a<b"), line(2.0, label="c&d"))
    assert "a&lt;b" in figure
    assert "c&amp;d" in figure
    assert len(set(re.findall(r"background:(#\w+)", figure))) == 2
    assert "<ul>" not in plot(line(1.0, label="a"))
