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


QUICK, SHORT, LONG = "weightfree_quick", "weightfree_fast", "weightfree"
"""Three ready pipelines that begin alike: the same points, then training with rates for its length."""

OWN_VIEWS, MOST_TIMES = 3, 3.0
"""Lengths were chosen with so many training views. More views get more iterations in proportion, up to so
many times. On four of six training views, scored on the others, three times as many gain 0.98 dB on
dtu_scan24, 0.31 on llff_fern and 0.02 on llff_flower, with dropout .3 in place of .2."""
QUICK_BELOW, QUICK_TIMES = 0.6, 2.0
"""The quick one is taken where less than this part of the short one's iterations fits in; and how much longer
than it is. On the same views it has 0.2 dB less than the short one on llff_fern and llff_flower and 1.3 on
dtu_scan24, in a third of its training time."""
SHORT_TIMES = 1.75
"""How much longer than it is the short one is taken: by ratio, half the way to the long one."""
GROWTH = {QUICK: (1.0, 1.0), SHORT: (1.15, 1.3), LONG: (1.3, 1.6)}
"""Gaussians over those that a run begins with: on average, and at the end. On llff_fern and llff_flower with
three views."""


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
        return Taken(QUICK, times, f"the quickest good look without a network{longer}")
    return Taken(SHORT, times, f"the best in seconds without a network{longer}")


def by_length(affordable: float, views: int) -> Taken:
    """What is taken where the time allows so many iterations, over the short one's; its `times` are the most.

    Args:
        views: that train.
    """
    times = _times(views)
    if affordable > SHORT_TIMES * times:
        return Taken(LONG, times, "there is time for the longest of three without a network")
    if affordable < QUICK_BELOW * times:
        return Taken(QUICK, QUICK_TIMES * times, "there is time for a quick look")
    return Taken(
        SHORT, SHORT_TIMES * times, "there is time for the middle one of three without a network"
    )


def _times(views: int) -> float:
    return min(max(views / OWN_VIEWS, 1.0), MOST_TIMES)
