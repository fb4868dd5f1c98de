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
        length: as a part of its own number of iterations.
        because: why it, in one clause.
    """

    name: str
    length: float
    because: str


SHORT, LONG = "weightfree_fast", "weightfree"
"""Two ready pipelines that begin alike: the same points, then training with rates for its length."""

BY_QUALITY: dict[Quality, Taken] = {
    "fast": Taken(SHORT, 0.5, "the best that needs no network, half as long"),
    "good": Taken(SHORT, 1.0, "the best that needs no network, in seconds"),
    "best": Taken(LONG, 1.0, "the best that needs no network, in minutes"),
}

SHORT_UP_TO = 900
"""Iterations, between the 400 and the 2,000 that the two were made for (the mean of their logarithms):
more are the longer one's."""


def by_length(affordable: int) -> Taken:
    """What is taken where so many iterations fit into the time."""
    if affordable > SHORT_UP_TO:
        return Taken(LONG, 1.0, f"for more than {SHORT_UP_TO} iterations")
    return Taken(SHORT, 1.0, f"for up to {SHORT_UP_TO} iterations")
