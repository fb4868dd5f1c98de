"""The settings of `consistency_dense`."""

from __future__ import annotations

from typing import Annotated, Any, get_args

from pydantic import Field, field_validator

from registry import Settings

from .understanding.kinds import SceneKind

Names = str | Annotated[tuple[str, ...], Field(min_length=1)]
"""One prior or several."""


class ConsistencyDenseSettings(Settings):
    prior: Names | dict[SceneKind, Names] | None = None
    """Which multi-view depth prior to ask; null takes the pipeline's only one. Of several in a list, each
    pixel takes the depth that most other views confirm, the earlier prior's if as many do. A mapping of
    all three kinds of scene (forward-facing, object, surrounding) says it for each."""
    max_reprojection_error: float = Field(1.0, gt=0)
    """Pixels by which a pixel may miss itself on its way to another view and back."""
    max_depth_error: float = Field(0.01, gt=0, lt=1)
    """How much the two views' depths may differ, relative to the depth."""
    min_consistent: int | None = Field(None, ge=1)
    """How many other views must confirm a depth; null: half of them, three at most."""
    min_component: int = Field(0, ge=0)
    """Pixels; connected patches of confirmed surface that are smaller are dropped."""
    stride: int = Field(1, ge=1)
    """One point for each square of so many by so many pixels."""
    merge: bool = False
    """Leave out points on surfaces that an earlier view has confirmed: fewer points, sharper pictures."""
    max_points: int | None = Field(150_000, ge=1)
    """A random choice of so many points is kept; null keeps all."""
    sigma: float | None = Field(None, gt=0)
    """Size of the Gaussians, as a part of their spacing in the image; null: from the three nearest
    neighbours."""
    opacity: float | None = Field(None, gt=0, lt=1)
    """First opacity; null: the pipeline's `training.initial_opacity`."""
    fill: bool = False
    """Guess depths where none is confirmed, from neighbours of the same colour; not where a pixel shows
    the scene's background. If less than a quarter of what would then be known is confirmed, nothing is
    guessed, and matched features are the points, as of `sfm`, unless there are few."""
    fill_shown: bool = True
    """With `fill`: guess also where a confirmed point of another view falls that has the pixel's colour.
    Without, there are fewer points, and fewer wrong ones around objects (benchmarks/notes.md)."""
    background_range: int = Field(2, ge=0, le=255)
    """8-bit levels: a colour whose channels all differ by less from the scene's background counts as it, and
    no point is guessed there. Photographs of objects before black are rarely black to the last level."""
    back_layer: bool = False
    """Put coarse points of the background's colour behind the edges of the foreground. Those that no view can
    see are of the kind `hidden` too, but not around an object: what its edges hide is its own side."""
    margin: bool = False
    """Put a ring of coarse points around each image."""
    hand_on_depth: bool = False
    """Hand the confirmed depths on to components that train on them (`PointCloud.maps`)."""

    @field_validator("prior")
    @classmethod
    def _names_every_kind(cls, prior: Any) -> Any:
        missing = [
            kind for kind in get_args(SceneKind) if isinstance(prior, dict) and kind not in prior
        ]
        if missing:
            raise ValueError(f"`prior` names none for scenes of the kind {', '.join(missing)}")
        return prior
