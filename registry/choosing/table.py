"""Which ready pipeline is taken when nobody names one: the one place that says so."""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

Quality = Literal["fast", "good", "best"]
"""What `--quality` understands, from little time to much."""
QUALITIES: tuple[Quality, ...] = get_args(Quality)


class Taken(NamedTuple):
    """A ready pipeline and a length.

    Args:
        name: of the pipeline.
        times: length over the pipeline's own.
        because: why it, in one clause.
    """

    name: str
    times: float
    because: str


SHORT, LONG = "weightfree_fast", "weightfree"
"""Two ready pipelines that begin alike: the same points, then training with rates for its length."""

OWN_VIEWS, MOST_TIMES = 3, 3.0
"""The short one's length was chosen with so many training views. More views get more iterations in
proportion, up to so many times: on dtu_scan24 with six views twice as many gain 0.67 dB, on llff_fern with
three none."""
SHORT_UP_TO = 900
"""Iterations, between the 400 and the 2,000 that the two were made for (the mean of their logarithms):
more are the longer one's."""


def by_quality(quality: Quality, views: int) -> Taken:
    """What is taken where time is no matter of seconds.

    Args:
        views: that train.
    """
    if quality == "best":
        return Taken(LONG, 1.0, "the best that needs no network, in minutes")
    times = min(max(views / OWN_VIEWS, 1.0), MOST_TIMES)
    longer = f", {times:.1f} times as long for {views} views" if times > 1 else ""
    if quality == "fast":
        return Taken(SHORT, 0.5 * times, f"half of the best in seconds without a network{longer}")
    return Taken(SHORT, times, f"the best in seconds without a network{longer}")


def by_length(affordable: int) -> Taken:
    """What is taken where so many iterations fit into the time, and how long it may become at most."""
    if affordable > SHORT_UP_TO:
        return Taken(LONG, 1.0, f"made for more than {SHORT_UP_TO} iterations")
    return Taken(SHORT, 1.0, f"made for up to {SHORT_UP_TO} iterations")
