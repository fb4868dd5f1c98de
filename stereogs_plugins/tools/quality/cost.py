"""What a run takes, as far as it can be told before its first iteration."""

from __future__ import annotations

from dataclasses import dataclass

from registry import RunError

LEAST_ITERATIONS = 50
"""Fewer are no training worth the seconds before and after it."""
CLOSING = 0.35
"""Checkpoints, exports and pages, as a part of the seconds that quick scores of all views take: both are
decoding, drawing and compressing of as many pictures."""


@dataclass(frozen=True)
class Cost:
    """Seconds of a run.

    Args:
        spent: until now.
        iteration: of one iteration.
        after: from the last iteration on: scores, pictures, exports, reports.
    """

    spent: float
    iteration: float
    after: float

    def seconds(self, iterations: int) -> float:
        """Of the whole run."""
        return self.spent + iterations * self.iteration + self.after

    def iterations(self, seconds: float) -> int:
        """How many fit into a run of so many seconds; below 1 if none does."""
        return int((seconds - self.spent - self.after) / self.iteration)

    def refuse_too_little(self, seconds: float, least: int) -> None:
        """Raise if not even the fewest iterations that are worth it fit.

        Raises:
            RunError: says what the seconds go into, and how many would do.
        """
        if self.iterations(seconds) >= least:
            return
        needed = self.seconds(least)
        raise RunError(
            f"{seconds:g} s are too few: photographs and first points took {self.spent:.1f} s, scores and "
            f"files will take {self.after:.1f} s, and each iteration {self.iteration:.3f} s",
            where="--seconds",
            fix=f"about {needed:.0f} s are the least here, for {least} iterations; smaller or fewer "
            "photographs take less",
        )
