"""Settings of `consistency_dense`."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

from pydantic import Field, field_validator

from registry import Settings

SceneKind = Literal["forward-facing", "object", "surrounding"]
Names = str | Annotated[tuple[str, ...], Field(min_length=1)]
"""Name of one prior, or of several."""


class ConsistencyDenseSettings(Settings):
    prior: Names | dict[SceneKind, Names] | None = None
    """Name of the multi-view depth prior; null takes the pipeline's only one. With a list, each pixel takes
    the depth that most other views confirm; ties go to the earlier prior. A mapping gives a name or list
    for each of the three kinds of scene (forward-facing, object, surrounding)."""
    max_views: int | None = Field(48, ge=2)
    """Estimate the depth of at most this many training views, evenly spread in their order; null: of all.
    More take longer and gain little."""
    max_reprojection_error: float = Field(1.0, gt=0)
    """Largest reprojection error of a pixel, through another view and back, in pixels."""
    max_depth_error: float = Field(0.01, gt=0, lt=1)
    """Largest difference between the depths of two views, relative to the depth."""
    min_consistent: int | None = Field(None, ge=1)
    """Number of other views that must confirm a depth; null: half of them, at most three."""
    min_component: int = Field(0, ge=0)
    """Drop connected patches of confirmed surface with fewer pixels than this."""
    stride: int = Field(1, ge=1)
    """One point per square of this many by this many pixels."""
    merge: bool = False
    """Drop points on surfaces that an earlier view has confirmed: fewer points, sharper pictures."""
    max_points: int | None = Field(150_000, ge=1)
    """Keep a random choice of this many points; null keeps all."""
    sigma: float | None = Field(None, gt=0)
    """Size of the Gaussians relative to their spacing in the image; null: from the three nearest
    neighbours."""
    opacity: float | None = Field(None, gt=0, lt=1)
    """Initial opacity; null: the pipeline's `training.initial_opacity`."""
    fill: bool = False
    """Guess unconfirmed depths from neighbours of the same colour, except where a pixel shows the scene's
    background. If less than a quarter of the resulting surface is confirmed, matched features, as in
    `sfm`, replace all points unless they are few."""
    fill_shown: bool = True
    """With `fill`: also guess where a confirmed point of another view with the pixel's colour falls. False
    gives fewer points, and fewer wrong ones around objects (benchmarks/notes.md)."""
    fill_planes: bool = False
    """With `fill`: continue the plane of a wall, floor or table into its holes first. Without effect unless
    all cameras look the same way: around objects it would cost up to 2 dB (benchmarks/notes.md)."""
    background_range: int = Field(2, ge=0, le=255)
    """8-bit levels. A colour counts as the scene's background if every channel differs by less; no points
    are guessed there. Photographs of objects on black are rarely exactly black."""
    back_layer: bool = False
    """Put coarse points of the background's colour behind foreground edges. Those that no view can see are
    also of the kind `hidden`, except around an object, whose edges hide its own side."""
    margin: bool = False
    """Put a ring of coarse points around each image."""
    hand_on_depth: bool = False
    """Pass the confirmed depths to components that train on them (`PointCloud.maps`)."""

    @field_validator("prior")
    @classmethod
    def _names_every_kind(cls, prior: Any) -> Any:
        missing = [
            kind for kind in get_args(SceneKind) if isinstance(prior, dict) and kind not in prior
        ]
        if missing:
            raise ValueError(f"`prior` lacks a name for scenes of the kind {', '.join(missing)}")
        return prior
