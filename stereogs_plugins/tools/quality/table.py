"""Which ready pipeline is taken when nobody names one: the one place that says so."""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

Quality = Literal["fast", "good", "best"]
"""What `--quality` understands, from little time to much."""
QUALITIES: tuple[Quality, ...] = get_args(Quality)


class Taken(NamedTuple):
    """A ready pipeline.

    Args:
        name: of the pipeline.
        because: why it, in one clause.
        times: the most that it may be longer than it is for the scene.
    """

    name: str
    because: str
    times: float = 1.0


QUICK, SHORT, LONG = "weightfree_quick", "weightfree_fast", "weightfree"
"""Three ready pipelines that begin alike: the same points, then training with rates for its length."""

QUICK_BELOW, QUICK_TIMES = 0.6, 2.0
"""The quick one is taken where less than this part of the short one's iterations fits in; and how much longer
than it is. On the same views it has 0.2 dB less than the short one on llff_fern and llff_flower and 1.3 on
dtu_scan24, in a third of its training time."""
SHORT_TIMES = 1.75
"""How much longer than it is the short one is taken: by ratio, half the way to the long one."""
GROWTH = {QUICK: (1.0, 1.0), SHORT: (1.15, 1.3), LONG: (1.3, 1.6)}
"""Gaussians over those that a run begins with: on average, and at the end. On llff_fern and llff_flower with
three views."""


def by_quality(quality: Quality) -> Taken:
    """What is taken where no time is given."""
    if quality == "best":
        return Taken(LONG, "the best in minutes without a network")
    if quality == "fast":
        return Taken(QUICK, "the quickest good look without a network")
    return Taken(SHORT, "the best in seconds without a network")


def by_length(affordable: float) -> Taken:
    """What is taken where the time allows so many iterations, over the short one's for the scene."""
    if affordable > SHORT_TIMES:
        return Taken(LONG, "there is time for the longest of three without a network")
    if affordable < QUICK_BELOW:
        return Taken(QUICK, "there is time for a quick look", QUICK_TIMES)
    return Taken(SHORT, "there is time for the middle one of three without a network", SHORT_TIMES)
