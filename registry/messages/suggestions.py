"""Phrases of messages: the nearest known name, lists, and counts."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return "; did you mean 'x'?" with the nearest known name, or "" if none is near."""
    by_lower = {candidate.lower(): candidate for candidate in known}
    near = get_close_matches(name.lower(), by_lower, n=1, cutoff=0.6)
    return f"; did you mean {by_lower[near[0]]!r}?" if near else ""


def listing(names: Iterable[str]) -> str:
    """Return the names separated by commas, or "none"."""
    return ", ".join(names) or "none"


def counted(count: int, noun: str) -> str:
    """Return for example "1 view" or "1,200 views"."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"
