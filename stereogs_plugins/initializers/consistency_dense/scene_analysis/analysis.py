"""The kind of a scene, its plain background, and the points that silhouettes refute.

A view that shows plain background has nothing in front of it there. The space that all silhouettes leave
is the visual hull (Laurentini 1994).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from ..projection import pixel_of, project
from ..visibility import spread

if TYPE_CHECKING:
    from collections.abc import Sequence

    from core_rasterizer import Camera
    from registry import TrainingView

    from ..projection import DepthImage, Floats, Mask
    from ..settings import SceneKind
    from .plain_background import PlainAreas

VOTES_AGAINST_CONFIRMED = 2
"""Views that must show background in place of a confirmed point to drop it; a guess is dropped by one."""
WIDEST_FORWARD = 35.0
"""Largest angle between two camera axes of a forward-facing capture, degrees."""
MIN_BACKGROUND = 0.1
"""Least share of plain background in the median view of an object."""
SAFETY = 0.01
"""Width of the ignored strip along silhouettes, relative to the image's longer side."""


@dataclass(frozen=True, eq=False)
class SceneAnalysis:
    """Result of the analysis.

    Args:
        kind: kind of scene.
        cameras: cameras of the training views.
        backgrounds: `[H, W]` for each view, the pixels that show plain background.
        safe: the same without a strip along silhouettes.
    """

    kind: SceneKind
    cameras: tuple[Camera, ...]
    backgrounds: tuple[Mask, ...]
    safe: tuple[Mask, ...]

    @classmethod
    def without_depths(cls, views: Sequence[TrainingView], areas: PlainAreas) -> Self:
        """Analyse cameras and plain areas before any depth is known."""
        unknown = [np.zeros(view.image.shape[:2], dtype=np.float32) for view in views]
        return cls.of(views, areas, unknown)

    @classmethod
    def of(
        cls, views: Sequence[TrainingView], areas: PlainAreas, confirmed: Sequence[DepthImage]
    ) -> Self:
        """Analyse cameras, plain areas and the confirmed depths `[H, W]`."""
        cameras = tuple(view.camera for view in views)
        backgrounds = tuple(areas.backgrounds(confirmed))
        kind = scene_kind(cameras, backgrounds)
        return cls(kind, cameras, backgrounds, tuple(map(safely_inside, backgrounds)))

    @property
    def wide(self) -> bool:
        """True if views look from many sides: chance agreements are common, and views can outvote them."""
        return self.kind != "forward-facing"

    @property
    def background_share(self) -> float:
        """Share of plain background in the pixels of all views."""
        pixels = sum(mask.size for mask in self.backgrounds)
        return sum(int(mask.sum()) for mask in self.backgrounds) / pixels

    @property
    def summary(self) -> str:
        """One line for the log."""
        share = self.background_share
        shown = f", {share:.0%} of the pixels show plain background" if share else ""
        return f"the scene is taken as {self.kind}{shown}"

    def facts(self) -> dict[str, Any]:
        """Facts for the results."""
        return {"scene_kind": self.kind, "plain_background": round(self.background_share, 4)}

    def without_background(self, depths: Sequence[DepthImage]) -> list[DepthImage]:
        """Set depths `[H, W]` of pixels that safely show plain background to 0."""
        return [
            np.where(safe, np.float32(0), depth)
            for safe, depth in zip(self.safe, depths, strict=True)
        ]

    def refutes(self, points: Floats, *, guessed: bool) -> Mask:
        """World points `[P, 3]` in whose place enough views show safe plain background."""
        votes = np.zeros(len(points), dtype=np.intp)
        for camera, background in spread([*zip(self.cameras, self.safe, strict=True)]):
            if not background.any():
                continue
            u, v, _ = project(camera, points)
            within, row, column = pixel_of(background.shape, u, v)
            votes += within & background[row, column]
        refuted: Mask = votes >= (1 if guessed else VOTES_AGAINST_CONFIRMED)
        return refuted


def scene_kind(cameras: Sequence[Camera], backgrounds: Sequence[Mask]) -> SceneKind:
    """Classify a scene.

    Args:
        cameras: cameras of the training views.
        backgrounds: `[H, W]` plain background of each view.

    Returns:
        "object" if plain background surrounds it; "forward-facing" if all cameras look the same way;
        otherwise "surrounding": a room, a place, or an object in one.
    """
    if np.median([mask.mean() for mask in backgrounds]) >= MIN_BACKGROUND:
        return "object"
    axes = np.stack([camera.world_to_camera[2, :3].numpy() for camera in cameras])
    widest = np.degrees(np.arccos((axes @ axes.T).clip(-1, 1).min()))
    return "forward-facing" if widest < WIDEST_FORWARD else "surrounding"


def safely_inside(background: Mask) -> Mask:
    """Pixels of plain background well away from other content and from the image border."""
    import cv2

    if not background.any():
        return background
    padded = np.pad(background, 1).view(np.uint8)
    distance = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    safe: Mask = distance > 1 + SAFETY * max(background.shape)
    return safe
