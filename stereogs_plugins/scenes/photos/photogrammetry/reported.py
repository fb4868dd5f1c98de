"""Progress of COLMAP, which has no callbacks: the rows that it has written to its database."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from registry.toolkit.progress import progress

from .colmap import open_database

if TYPE_CHECKING:
    from .colmap import Database

SECONDS = 0.5
"""Between two looks at the database."""


@contextmanager
def rows_reported(
    database: Path, count: Callable[[Database], int], stage: str, total: int
) -> Iterator[None]:
    """Report a number of rows while the block fills a database.

    COLMAP's own SQLite reads it. With a second SQLite library in the process, such as Python's, the locks of
    one end when the other closes the file, and the process ends with SIGBUS now and then
    (https://sqlite.org/howtocorrupt.html, "Multiple copies of SQLite linked into the same application").

    Args:
        database: existing COLMAP database.
        count: returns the number of rows of an open database.
        stage, total: as for `registry.toolkit.progress`.
    """
    finished = threading.Event()

    def look() -> None:
        while not finished.wait(SECONDS):
            progress(stage, count(opened), total)

    progress(stage, 0, total)
    with open_database(database) as opened:
        thread = threading.Thread(target=look, name="rows of COLMAP", daemon=True)
        thread.start()
        try:
            yield
        finally:
            finished.set()
            thread.join()
    progress(stage, total, total)
