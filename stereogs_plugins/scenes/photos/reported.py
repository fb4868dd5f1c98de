"""Progress of COLMAP, which has no callbacks: the rows that it has written to its database."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from registry.toolkit.progress import progress

SECONDS = 0.5
"""Between two looks at the database."""


@contextmanager
def rows_reported(database: Path, table: str, stage: str, total: int) -> Iterator[None]:
    """Report the number of rows in a table while the block fills it.

    Args:
        database: existing COLMAP database.
        stage, total: as for `registry.toolkit.progress`.
    """
    finished = threading.Event()

    def look() -> None:
        with closing(
            sqlite3.connect(f"{database.absolute().as_uri()}?mode=ro", uri=True)
        ) as opened:
            while not finished.wait(SECONDS):
                try:
                    (count,) = opened.execute(f"SELECT COUNT(*) FROM {table}").fetchone()
                except sqlite3.OperationalError:  # it is locked at the moment
                    continue
                progress(stage, count, total)

    progress(stage, 0, total)
    thread = threading.Thread(target=look, name="rows of COLMAP", daemon=True)
    thread.start()
    try:
        yield
    finally:
        finished.set()
        thread.join()
    progress(stage, total, total)
