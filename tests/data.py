"""Where tests find real data: the folder that STEREOGS_DATA names."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def data_folder(name: str) -> Path:
    """The data set's folder, or a skipped test that says what to set."""
    root = os.environ.get("STEREOGS_DATA")
    folder = Path(root, name) if root else None
    if folder is None or not folder.is_dir():
        pytest.skip(f"set STEREOGS_DATA to the folder that holds {name}")
    return folder
