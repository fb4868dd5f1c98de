"""What a pipeline names as its scene loader where the scene was made in Python."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..errors import SceneError
from .component import Settings
from .components import SceneLoader

if TYPE_CHECKING:
    from .scene import Scene

IN_MEMORY = "in_memory"
"""Its name in a pipeline. It belongs to the host: no plugin offers it."""


class InMemoryScene(SceneLoader[Settings]):
    """Stands for a scene that whoever trained gave as an object, and that no file holds."""

    def load(self) -> Scene:
        """Refuse.

        Raises:
            SceneError: always; only who made the scene can give it again.
        """
        raise SceneError(
            "the pipeline names no photographs: its scene is one that was made in Python",
            where=f"scene: {IN_MEMORY}",
            fix="give the scene too, stereogs.train(pipeline, scene=...) or "
            "stereogs.open_run(folder, scene=...); or name a loader, scene: {use: ..., path: ...}",
        )
