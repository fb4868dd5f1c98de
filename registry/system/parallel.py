"""Work on many photographs or views at once.

Each thread holds what its work takes: one photograph at full size is 3 or 4 bytes a pixel, a view in memory
12 bytes a pixel of the training size.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_parallel(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """`work` done to each item, in order, on as many threads as there are cores.

    Pillow and numpy let go of the interpreter's lock while they work.
    """
    threads = min(len(items), os.cpu_count() or 1)
    if threads < 2:
        return [work(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, items))
