"""Nearest names: every "unknown ..." error says what was probably meant."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A half sentence "; did you mean 'x'?", or nothing when no known name is near."""
    by_lower = {candidate.lower(): candidate for candidate in known}
    near = get_close_matches(name.lower(), by_lower, n=1, cutoff=0.6)
    return f"; did you mean {by_lower[near[0]]!r}?" if near else ""


def listing(names: Iterable[str]) -> str:
    """The names separated by commas, or "none"."""
    return ", ".join(names) or "none"
