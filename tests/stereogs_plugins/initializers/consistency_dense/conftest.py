from __future__ import annotations

from dataclasses import replace

import pytest

from registry import Scene


@pytest.fixture(scope="module")
def scene(procedural_room: Scene) -> Scene:
    """The drawn room without test views and points."""
    return replace(procedural_room, test=(), points=None)
