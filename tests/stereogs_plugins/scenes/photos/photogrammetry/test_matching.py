"""Progress of COLMAP."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest

from registry.toolkit.photos import import_pycolmap
from stereogs_plugins.scenes.photos.photogrammetry import matching


def test_rows_are_counted_by_colmaps_own_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second SQLite library in the process breaks the locks of the first."""
    colmap, file = import_pycolmap(3), tmp_path / "matches.db"
    monkeypatch.setattr(sqlite3, "connect", lambda *_, **__: pytest.fail("a second library"))
    monkeypatch.setattr(matching, "SECONDS", 0.0)
    seen: list[tuple[str, int, int]] = []
    monkeypatch.setattr(matching, "progress", lambda *known: seen.append(known))
    with colmap.Database.open(file) as database:
        database.write_camera(colmap.Camera.create_from_model_name(1, "PINHOLE", 9, 8, 6), True)
        with matching.rows_reported(file, lambda d: d.num_cameras(), "cameras", 2):
            while ("cameras", 1, 2) not in seen:
                assert len(seen) < 1_000_000
            database.write_camera(colmap.Camera.create_from_model_name(2, "PINHOLE", 9, 8, 6), True)
    assert seen[0] == ("cameras", 0, 2)
    assert seen[-1] == ("cameras", 2, 2)
    assert np.all(np.diff([count for _, count, _ in seen]) >= 0)
