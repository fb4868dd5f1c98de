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
"""Lengths were chosen with so many training views. More views get more iterations in proportion, up to so
many times: twice as many gain 0.67 dB on dtu_scan24 with six views, and 0.21 on llff_fern with three."""
SHORT_TIMES = 3.0
"""How much longer than it is the short one is taken where there is time. On llff_fern with three views it has
23.62 dB at twice its length, the longer one 23.54 when made as short, and 23.83 at its own five times."""
GROWTH = {SHORT: (1.2, 1.4), LONG: (1.9, 2.2)}
"""Gaussians over those that a run begins with: on average, and at the end. On llff_fern with three views."""


def by_quality(quality: Quality, views: int) -> Taken:
    """What is taken where no time is given.

    Args:
        views: that train.
    """
    times = _times(views)
    longer = f", {times:.2g}x as long for {views} views" if times > 1 else ""
    if quality == "best":
        return Taken(LONG, times, f"the best in minutes without a network{longer}")
    if quality == "fast":
        return Taken(SHORT, 0.5 * times, f"half the best in seconds without a network{longer}")
    return Taken(SHORT, times, f"the best in seconds without a network{longer}")


def by_length(affordable: float, views: int) -> Taken:
    """What is taken where the time allows so many iterations, over the short one's; its `times` are the most.

    Args:
        views: that train.
    """
    times = _times(views)
    if affordable > SHORT_TIMES * times:
        return Taken(LONG, times, "there is time for the longer one of two without a network")
    return Taken(
        SHORT, SHORT_TIMES * times, "there is time for the shorter of two without a network"
    )


def _times(views: int) -> float:
    return min(max(views / OWN_VIEWS, 1.0), MOST_TIMES)
