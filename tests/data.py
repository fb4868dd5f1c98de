"""Where tests find real data and networks: the folders that STEREOGS_DATA and STEREOGS_MODELS name."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def data_folder(name: str) -> Path:
    """The data set's folder, or a skipped test that says what to set."""
    return _folder("STEREOGS_DATA", name)


def models_folder(name: str) -> Path:
    """The folder with a network's files, or a skipped test that says what to set."""
    return _folder("STEREOGS_MODELS", name)


def _folder(variable: str, name: str) -> Path:
    root = os.environ.get(variable)
    folder = Path(root, name) if root else None
    if folder is None or not folder.is_dir():
        pytest.skip(f"set {variable} to the folder that holds {name}")
    return folder
