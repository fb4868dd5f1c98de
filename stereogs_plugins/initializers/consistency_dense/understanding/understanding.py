"""The scene's kind and its plain background, and what follows from them for points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from .scene_kind import scene_kind
from .silhouettes import outside_votes, safely_inside

if TYPE_CHECKING:
    from collections.abc import Sequence

    from core_rasterizer import Camera
    from registry import TrainingView

    from ..projection import DepthImage, Floats, Mask
    from .kinds import SceneKind
    from .plain_background import PlainAreas

VOTES_AGAINST_CONFIRMED = 2
"""Views that must show background in place of a point that two views agree on; a guess falls by one."""


@dataclass(frozen=True, eq=False)
class Understanding:
    """What is understood of a scene.

    Args:
        kind: of scene.
        cameras: of the training views.
        backgrounds: `[H, W]` for each view, the pixels that show plain background.
        safe: the same without a strip along silhouettes.
    """

    kind: SceneKind
    cameras: tuple[Camera, ...]
    backgrounds: tuple[Mask, ...]
    safe: tuple[Mask, ...]

    @classmethod
    def at_first_sight(cls, views: Sequence[TrainingView], areas: PlainAreas) -> Self:
        """What cameras and the photographs' plain areas tell while no depth is known."""
        unknown = [np.zeros(view.image.shape[:2], dtype=np.float32) for view in views]
        return cls.of(views, areas, unknown)

    @classmethod
    def of(
        cls, views: Sequence[TrainingView], areas: PlainAreas, confirmed: Sequence[DepthImage]
    ) -> Self:
        """What cameras, plain areas and the depths `[H, W]` that views agree on tell."""
        cameras = tuple(view.camera for view in views)
        backgrounds = tuple(areas.backgrounds(confirmed))
        kind = scene_kind(cameras, backgrounds)
        return cls(kind, cameras, backgrounds, tuple(map(safely_inside, backgrounds)))

    @property
    def wide(self) -> bool:
        """Whether views look from so many sides that chance agreements abound and others can outvote them."""
        return self.kind != "forward-facing"

    @property
    def background_share(self) -> float:
        """Of all pixels of all views."""
        pixels = sum(mask.size for mask in self.backgrounds)
        return sum(int(mask.sum()) for mask in self.backgrounds) / pixels

    @property
    def sentence(self) -> str:
        """For the log."""
        share = self.background_share
        shown = f", {share:.0%} of the pixels show plain background" if share else ""
        return f"the scene is taken as {self.kind}{shown}"

    def facts(self) -> dict[str, Any]:
        """For the results."""
        return {"scene_kind": self.kind, "plain_background": round(self.background_share, 4)}

    def without_background(self, depths: Sequence[DepthImage]) -> list[DepthImage]:
        """Depths `[H, W]` of each view without those of pixels that safely show plain background."""
        return [
            np.where(safe, np.float32(0), depth)
            for safe, depth in zip(self.safe, depths, strict=True)
        ]

    def refutes(self, points: Floats, *, guessed: bool) -> Mask:
        """Which world points `[P, 3]` stand where views see past them to plain background."""
        needed = 1 if guessed else VOTES_AGAINST_CONFIRMED
        refuted: Mask = outside_votes(points, self.cameras, self.safe) >= needed
        return refuted
