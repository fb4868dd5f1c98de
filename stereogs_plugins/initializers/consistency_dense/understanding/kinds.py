"""The names of the kinds of scene, apart from what tells them: settings speak of them too."""

from __future__ import annotations

from typing import Literal

SceneKind = Literal["forward-facing", "object", "surrounding"]
