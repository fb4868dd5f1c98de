"""From photographs with poses and a split to a scene; every loader of real pictures ends here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from ...contract.checks.scene import validate
from ...contract.fact import Fact
from ...contract.scene import PointCloud, Scene, View
from ...errors import SceneError
from .images.decoder import Decoder, stored_size
from .images.image_files import find_image
from .posed_photos import PosedPhoto, load_views

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from core_rasterizer import Camera

    from .cameras.bounds import Bounds


@dataclass(frozen=True, eq=False)
class LoadedPhotos:
    """The photographs of a scene and the views that became of them.

    Args:
        photos, views: in one order, those that train first.
        decoder: how they were read.
        train, test: their numbers, as the format counts photographs.
    """

    photos: Sequence[PosedPhoto]
    views: Sequence[View]
    decoder: Decoder
    train: list[int]
    test: list[int]

    @classmethod
    def load(
        cls, photos: Sequence[PosedPhoto], decoder: Decoder, train: list[int], test: list[int]
    ) -> Self:
        """Read photographs, in the order `train`, `test`.

        Raises:
            SceneError: see `load_views`.
        """
        return cls(photos, load_views(photos, decoder), decoder, train, test)

    @property
    def training_cameras(self) -> list[Camera]:
        """What depth bounds may be estimated from."""
        return [view.camera for view in self.views[: len(self.train)]]

    def require_one_size(self) -> None:
        """Refuse views of several sizes where the format promises one.

        Raises:
            SceneError: names the first view that differs from most.
        """
        sizes = [(view.camera.width, view.camera.height) for view in self.views]
        usual = max(sizes, key=sizes.count)
        for photo, size in zip(self.photos, sizes, strict=True):
            if size != usual:
                raise SceneError(
                    f"the image is {size[0]}x{size[1]}, the others are {usual[0]}x{usual[1]}",
                    where=str(photo.path),
                    fix="resize all photographs of the scene in one way",
                )

    def split_facts(self, rule: str, available: int | None = None) -> tuple[Fact, ...]:
        """The split by numbers of photographs.

        Args:
            rule: says in words how it was made.
            available: how many photographs with cameras there are; those in neither part are left out.
                None where the format does not say.
        """
        counts: tuple[Fact, ...] = ()
        if available is not None:
            left_out = available - len(self.train) - len(self.test)
            text = f"{available}, {left_out} of them left out by the split"
            counts = (Fact("photographs", available, text, affects_scores=False),)
        return (
            *counts,
            Fact("split", rule),
            Fact("train_photographs", tuple(self.train)),
            Fact("test_photographs", tuple(self.test)),
        )

    def scene(
        self,
        format_name: str,
        folder: Path,
        bounds: Bounds,
        points: PointCloud | None,
        facts: Iterable[Fact],
    ) -> Scene:
        """The scene, named after its folder, on the background that transparent pixels were laid on.

        Args:
            facts: what this format adds to those of every scene of photographs.

        Raises:
            SceneError: what `validate` refuses.
        """
        return validate(
            Scene(
                name=folder.resolve().name,
                train=tuple(self.views[: len(self.train)]),
                test=tuple(self.views[len(self.train) :]),
                bounds=bounds,
                points=points,
                background=self.decoder.background,
                facts=(
                    Fact("format", format_name),
                    Fact("source", self.photos[0].path.parent.name),
                    Fact("changed", "; ".join(_changes(self.photos[0], self.decoder)) or "nothing"),
                    *facts,
                ),
            )
        )


def _changes(photo: PosedPhoto, decoder: Decoder) -> list[str]:
    """What was done to a photograph, in words."""
    stored = stored_size(find_image(photo.path), upright=decoder.upright)
    size = decoder.size(*stored)
    changes = []
    if size != stored:
        changes.append(
            f"resized from {stored[0]}x{stored[1]} to {size[0]}x{size[1]} "
            f"with the {decoder.resize_filter} filter"
        )
    if not photo.lens.is_pinhole:
        changes.append(
            f"undistorted ({photo.lens.model}) and cropped to what was seen, by pycolmap, bilinear"
        )
    return changes
