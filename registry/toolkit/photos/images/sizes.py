"""The size that a photograph is brought to, as a rule on the size that it is stored in."""

from __future__ import annotations

from collections.abc import Callable

Size = tuple[int, int]
"""`(width, height)` in pixels."""
SizeRule = Callable[[int, int], Size]
"""Width and height wanted of a photograph that is stored with that width and height."""


def divided_by(divisor: int) -> SizeRule:
    """Each side divided and rounded, as the published protocols do."""
    return lambda width, height: (
        max(1, round(width / divisor)),
        max(1, round(height / divisor)),
    )


def at_most(largest: int) -> SizeRule:
    """At most `largest` pixels wide, in proportion; nothing is enlarged."""

    def size(width: int, height: int) -> Size:
        if width <= largest:
            return width, height
        return largest, max(1, round(height * largest / width))

    return size


def longest_side(largest: int) -> SizeRule:
    """The longer side at most `largest` pixels, in proportion; nothing is enlarged."""

    def size(width: int, height: int) -> Size:
        scale = min(1.0, largest / max(width, height))
        return max(1, round(width * scale)), max(1, round(height * scale))

    return size
