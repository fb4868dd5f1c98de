"""What tests of several plugins look at."""

from __future__ import annotations

import pytest

from registry import Scene
from stereogs_plugins.scenes.procedural import ProceduralScene
from tests.stereogs_plugins.building import build


@pytest.fixture(scope="session")
def procedural_room() -> Scene:
    """The furnished room with its usual settings; casting its rays takes seconds, so it is made once."""
    return build(ProceduralScene).load()
