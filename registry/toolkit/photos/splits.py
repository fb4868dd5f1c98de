"""Which photographs train and which test, where the data set does not say."""

from __future__ import annotations

from pydantic import Field

from ...contract.component import Settings
from ...errors import SceneError


class SplitSettings(Settings):
    """Settings that loaders with the sparse-view split share."""

    train_views: int | None = Field(3, ge=0)
    """How many training views; null or 0 takes all that are not test views."""
    test_every: int = Field(8, ge=2)
    """Every so-many-th photograph of the sorted list is a test view, from the first on."""


def split(
    count: int, test_every: int, train_views: int | None, where: str
) -> tuple[list[int], list[int]]:
    """Indices of the training and the test views among `count` sorted photographs.

    RegNeRF and the sparse-view literature since: every 8th photograph is a test view; of the rest, T,
    the training views are `T[round(x)]` for x in `linspace(0, len(T) - 1, n)`.

    Args:
        test_every: 0 keeps none for testing.

    Raises:
        SceneError: fewer than `train_views` photographs are left beside the test views.
    """
    test = list(range(0, count, test_every)) if test_every else []
    pool = sorted({*range(count)} - {*test})
    if not pool or (train_views or 0) > len(pool):
        raise SceneError(
            f"{train_views or 1} training views are wanted, but of {count} photographs only "
            f"{len(pool)} are not test views",
            where=where,
            fix=f"set `train_views` to at most {len(pool)}, or raise `test_every`",
        )
    return evenly_spaced(pool, train_views), test


def split_rule(test_every: int) -> str:
    """What `split` does, in words for the scene's facts."""
    if not test_every:
        return "evenly spaced train, none tests"
    return f"every {test_every}th tests, the others evenly spaced train"


def evenly_spaced(pool: list[int], wanted: int | None) -> list[int]:
    """`wanted` members, evenly over the pool, its ends included; None or 0 takes all."""
    import numpy as np

    # numpy rounds halves to even, as the published splits do.
    chosen = np.round(np.linspace(0, len(pool) - 1, wanted or len(pool))).astype(int)
    return [pool[k] for k in chosen]
