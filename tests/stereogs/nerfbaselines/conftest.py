"""These tests use the installed plugins, unlike others of the application."""

from __future__ import annotations

import pytest

from tests.host import SELECTION


@pytest.fixture(autouse=True)
def _no_installed_plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(SELECTION, raising=False)
