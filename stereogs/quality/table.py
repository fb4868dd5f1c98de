"""The ready pipelines that `--quality` and `--seconds` choose from."""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

Quality = Literal["fast", "good", "best"]
"""Values of `--quality`, from the shortest training to the longest."""
QUALITIES: tuple[Quality, ...] = get_args(Quality)


class Choice(NamedTuple):
    """A ready pipeline.

    Args:
        name: of the pipeline.
        reason: why it was chosen, in one clause.
        longest: largest factor by which its length may grow.
    """

    name: str
    reason: str
    longest: float = 1.0


QUICK, SHORT, LONG = "weightfree_quick", "weightfree_fast", "weightfree"
BEST = "weightfree_best"
"""Ready pipelines with the same initialization; their learning rates fit their lengths."""

QUICK_BELOW, QUICK_TIMES = 0.6, 2.0
"""QUICK is chosen if less than this share of SHORT's iterations fits; and its largest factor of growth. On
the same views its PSNR is 0.2 dB lower than SHORT's on llff_fern and llff_flower and 1.3 dB lower on
dtu_scan24, in a third of the training time."""
SHORT_TIMES, LONG_TIMES = 1.75, 1.75
"""Largest factors of growth of SHORT and LONG: by ratio, halfway to the next, three times as long."""
MANY, MANY_VIEWS = "many_views", 25
"""The ready pipeline, with the same initialization, from this number of training views on."""
MANY_TIMES: dict[Quality, float] = {"fast": 0.375, "good": 1.0, "best": 3.0}
"""Number of iterations for each quality, as a multiple of the pipeline's."""
FOR_MANY = Choice(MANY, f"there are {MANY_VIEWS} training views or more", MANY_TIMES["best"])
MANY_LEAST = 1000
"""It is not chosen for fewer iterations, as its rates are low; with a time limit, iterations of SHORT count.
On mview_temple with 21 views its PSNR is 3.1 dB above SHORT's after 1,500, and 2.5 dB below it after 500."""
GROWTH = {
    QUICK: (1.0, 1.0),
    SHORT: (1.15, 1.3),
    LONG: (1.3, 1.6),
    BEST: (1.5, 1.9),
    MANY: (1.9, 4.3),
}
"""Mean and final number of Gaussians as a multiple of the initial number, on llff_fern and llff_flower with
three views; of MANY the mean on llff_flower with 25, and the final number on blender_lego with 87."""


def by_quality(quality: Quality) -> Choice:
    """Return the pipeline for a quality and fewer views."""
    if quality == "best":
        return Choice(BEST, "it gives the best scores without a network, in minutes")
    if quality == "fast":
        return Choice(QUICK, "it is the fastest without a network")
    return Choice(SHORT, "it gives the best scores without a network, in seconds")


def by_length(affordable: float) -> Choice:
    """Return the pipeline for a number of iterations, as a multiple of SHORT's for the scene."""
    if affordable > 3 * LONG_TIMES:
        return Choice(BEST, "there is time for the longest of the four without a network")
    if affordable > SHORT_TIMES:
        return Choice(LONG, "there is time for the second longest of the four", LONG_TIMES)
    if affordable < QUICK_BELOW:
        return Choice(QUICK, "there is time only for the shortest of the four", QUICK_TIMES)
    return Choice(SHORT, "there is time for the second shortest of the four", SHORT_TIMES)
