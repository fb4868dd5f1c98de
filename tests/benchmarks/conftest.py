"""Plans of campaigns need the names of the folders of data and models, not the folders."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _folders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("STEREOGS_PLUGINS", raising=False)
    monkeypatch.setenv("STEREOGS_DATA", "data")
    monkeypatch.setenv("STEREOGS_MODELS", "a folder of ${models}")
