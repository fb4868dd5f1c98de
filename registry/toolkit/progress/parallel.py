"""Work on several photographs or views in parallel.

Memory per thread: 3 or 4 bytes per pixel for a photograph at full size, 12 for a view of the training size.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import count
from typing import TYPE_CHECKING, TypeVar

from ...system.cores import usable_cores
from .stages import progress

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_parallel(
    work: Callable[[Item], Result], items: Sequence[Item], *, stage: str | None = None
) -> list[Result]:
    """Return the results of `work` for each item, in order, with one thread per core.

    Pillow and numpy release the interpreter's lock while they work.

    Args:
        stage: reported with the number of finished items (`progress`).
    """
    threads, finished = min(len(items), usable_cores()), count(1)

    def reported(item: Item) -> Result:
        result = work(item)
        if stage is not None:
            progress(stage, next(finished), len(items))
        return result

    if stage is not None:
        progress(stage, 0, len(items))
    if threads < 2:
        return [reported(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(reported, items))
